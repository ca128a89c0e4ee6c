"""Planners by name: rules made by hand, or the learned policy."""

from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Reals
from saltus.config import PlannerName
from saltus.errors import ConfigError
from saltus.grid import HeightGrid
from saltus.models import model_path
from saltus.plan import Plan
from saltus.policy.observation import Observation, observe
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.states import standing_state


class Planner(Protocol):
    """Plans for any batch of robots, always the same ones or such as begin."""

    def step(self, observation: Observation, heights: Reals, fresh: NDArray[np.bool_] | bool = False) -> Plan:
        """Plans the next 10 ms.

        Args:
            observation: Of the robots now.
            heights: Relative to the base [m], shape (..., points).
            fresh: Robots that begin: what came before is forgotten; shape (...), or one for all.
        """
        ...


def make_planner(name: PlannerName, robot: Robot, grid: HeightGrid, model: str | Path | None = None) -> Planner:
    """A planner by its name, of robots that are given heights on a grid.

    The learned one comes from an ONNX file, by default the shipped policy.

    Raises:
        ModelError: the policy is damaged, or made for another program, robot or grid.
        ConfigError: rules cannot read such a grid.
    """
    if name == "learned":
        from saltus.policy.actor import PolicyActor  # here, so that rules need no ONNX Runtime

        return PolicyActor(robot, grid, model_path("policy", model))
    if model is not None:
        raise ConfigError(f"model = {model}: only the learned planner has one; add --planner learned")
    from saltus.policy.scripted import ScriptedPlanner

    return ScriptedPlanner(robot, grid)


def warm_up(planner: Planner, robot: Robot, grid: HeightGrid) -> None:
    """Plans once for a robot that stands on level ground, as a first call takes longer than the others."""
    standing = observe(standing_state(robot), LegKinematics(robot))
    planner.step(standing, np.full(grid.size, -robot.stand_height))
