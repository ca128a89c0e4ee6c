"""Planners by name: rules made by hand, or the learned policy."""

from pathlib import Path

import numpy as np

from saltus.config import PlannerName
from saltus.errors import ConfigError
from saltus.grid import HeightGrid
from saltus.loop.planner import Planner, observe
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.states import standing_state
from saltus.used_networks import POLICIES, model_path


def make_planner(
    name: PlannerName, robot: Robot, grid: HeightGrid, model: str | Path | None = None
) -> Planner:
    """A planner by its name, of robots that are given heights on a grid.

    The learned one comes from an ONNX file, by default the policy that is shipped for the robot.

    Raises:
        ModelError: the policy is damaged, or made for another program, robot or grid.
        ConfigError: rules cannot read such a grid.
    """
    if name == "learned":
        from saltus.policy.actor import PolicyActor  # here, so that rules need no ONNX Runtime

        return PolicyActor(robot, grid, model_path("policy", model, robot.name))
    if model is not None:
        raise ConfigError(
            f"model = {model}: only the learned planner has one; add --planner learned"
        )
    from saltus.policy.scripted import ScriptedPlanner

    return ScriptedPlanner(robot, grid)


def jumping_grid(robot: Robot) -> HeightGrid:
    """Where the planner of a robot that walks and is told to jump is given heights."""
    from saltus.policy.actor import grid_of  # here, so that rules need no ONNX Runtime

    return grid_of(model_path("policy", robot=robot.name))


def jumping_planner(robot: Robot) -> Planner:
    """The planner of a robot that walks and is told to jump, given heights on `jumping_grid`.

    It is the policy that is shipped for the robot, or rules where there is none.
    """
    name: PlannerName = "learned" if robot.name in POLICIES else "scripted"
    return make_planner(name, robot, jumping_grid(robot))


def warm_up(planner: Planner, robot: Robot, grid: HeightGrid) -> None:
    """Plans once for a robot that stands on level ground,
    as a first call takes longer than the others.
    """
    standing = observe(standing_state(robot), LegKinematics(robot))
    planner.step(standing, np.full(grid.size, -robot.stand_height))
