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
from saltus.trial import is_upright
from saltus.used_networks import WALKS, walking_path
from saltus.wire.messages import CommandMode, ControllerMode

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


def test_a_robot_without_one_needs_a_file() -> None:
    with pytest.raises(ConfigError, match=r"none for 'spot'; saltus policy walk train makes one"):
        walking_path("spot")
    assert walking_path("spot", "mine.onnx").name == "mine.onnx"
