"""Shipped walking policies are found by their robots' names, and go where they are told to."""

from collections.abc import Iterator
from itertools import takewhile

import numpy as np
import pytest

from saltus.controller.tick import CompiledTickLaw
from saltus.drive.wish import STAND, Wish
from saltus.errors import ConfigError
from saltus.grid import WALKING_GRID
from saltus.policy.evaluation.walking_grounds import make_walk_ground
from saltus.policy.evaluation.walking_trials import BEGINS_S, WalkTrials
from saltus.policy.evaluation.walks import TrueHeightSource, WalkStep, walk_steps
from saltus.policy.joints.policy import JointPolicy
from saltus.policy.joints.walker import Walker
from saltus.sim.plant_state import PlantState
from saltus.trial import is_upright
from saltus.used_networks import WALKS, walking_path
from saltus.wire.messages import CommandMode, ControllerMode, Heightmap, RobotState

STOPS_S = BEGINS_S + 4.0


def steps_of(robot: str, wish: Wish) -> Iterator[WalkStep]:
    """Four seconds of a command on level ground, and two to stand in."""
    model = walking_path(robot)
    settings = WalkTrials(robot=robot, grid=WALKING_GRID, model=model)
    setup, policy = settings.setup(make_walk_ground("plain", 0), 7), JointPolicy(model)
    places = setup.grid.places_of(policy.description.height_grid())
    run = walk_steps(
        setup,
        [Walker(setup.robot, policy, places)],
        TrueHeightSource(setup),
        lambda time_s, _: wish if time_s < STOPS_S else STAND,
        CompiledTickLaw(setup.robot),
    )
    return takewhile(lambda step: step.time_s < STOPS_S + 2.0, run)


@pytest.mark.sample(2)
@pytest.mark.parametrize("robot", WALKS)
@pytest.mark.parametrize(("ahead", "turn"), [(0.8, 0.0), (0.5, 0.5)])
def test_it_walks_as_it_is_told_to_and_stands(robot: str, ahead: float, turn: float) -> None:
    wish = Wish(mode=CommandMode.WALK, ahead_mps=ahead, turn_rps=turn)
    steps = list(steps_of(robot, wish))
    part = [step for step in steps if BEGINS_S + 1.0 <= step.time_s < STOPS_S]
    places = np.array([step.truth.position_base_in_world[:2] for step in part])
    way = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
    seconds = part[-1].time_s - part[0].time_s
    assert way / seconds == pytest.approx(ahead, abs=0.15)
    turned = np.mean([step.truth.angular_velocity_base[2] for step in part])
    assert turned == pytest.approx(turn, abs=0.15)
    assert steps[-1].mode == ControllerMode.STAND
    assert not any(step.touched for step in steps)
    assert all(is_upright(step.truth.quaternion_base_in_world) for step in steps)


@pytest.mark.parametrize("robot", WALKS)
def test_feet_that_are_trusted_while_it_walks_stand(robot: str) -> None:
    """Its heights take them for points of the ground: of ten that are trusted on
    rubble nine touch it, and most of those that touch it are trusted.
    """
    model = walking_path(robot)
    settings = WalkTrials(robot=robot, grid=WALKING_GRID, model=model)
    setup, policy = settings.setup(make_walk_ground("rubble", 3), 3), JointPolicy(model)
    told, trusted, on_ground = TrueHeightSource(setup), [], []

    def source(state: RobotState, truth: PlantState) -> Heightmap:
        trusted.append(state.leg_trusted)
        on_ground.append(truth.foot_force > 0.0)
        return told(state, truth)

    places = setup.grid.places_of(policy.description.height_grid())
    wish = Wish(mode=CommandMode.WALK, ahead_mps=0.8)
    run = walk_steps(
        setup, [Walker(setup.robot, policy, places)], source, lambda *_: wish,
        CompiledTickLaw(setup.robot),
    )  # fmt: skip
    modes = [step.mode for step in takewhile(lambda step: step.time_s < STOPS_S + 2.0, run)]
    walks = np.array(modes) == ControllerMode.WALK
    sure, on = np.array(trusted)[: len(walks)][walks], np.array(on_ground)[: len(walks)][walks]
    assert walks.sum() > 400
    assert on[sure].mean() > 0.9
    assert sure[on].mean() > 0.7


def test_a_robot_without_one_needs_a_file() -> None:
    with pytest.raises(ConfigError, match=r"none for 'spot'; saltus policy walk train makes one"):
        walking_path("spot")
    assert walking_path("spot", "mine.onnx").name == "mine.onnx"
