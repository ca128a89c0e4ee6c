"""Trials of jumps that are led: grounds that lie askew, headings, stops."""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
import pytest
from samples import setup_of

from saltus.config import TerrainConfig
from saltus.constants import POLICY_DT
from saltus.controller.robot.mujoco import MujocoRobot
from saltus.errors import ConfigError
from saltus.grid import WALKING_GRID
from saltus.policy.evaluation.walking_errands import STOP_WITHIN_M, run_stop
from saltus.policy.evaluation.walking_jumps import JUMPED, JumpAngles, jumped_ground, run_jump
from saltus.policy.evaluation.walking_trials import WalkTrials, WalkTrialTask
from saltus.policy.evaluation.walks import TrueHeightSource, WalkOperator, WalkStep
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.terrain.terrain import FIRST_EDGE_X, RUN_OUT, TRENCH_DEPTH
from saltus.trial import Trial
from saltus.used_networks import WALKS, walking_path
from saltus.wire.messages import CommandMode, ControllerMode

STANDS_S, SPEED_MPS = 1.0, 1.2


@pytest.mark.parametrize("name", JUMPED)
@pytest.mark.parametrize("degrees", [-30.0, 0.0, 30.0])
def test_a_ground_that_lies_askew_is_the_straight_one_turned_about_the_start(
    name: str, degrees: float
) -> None:
    straight, turned = jumped_ground(name, 3), jumped_ground(name, 3, degrees)
    assert turned.finish_x == pytest.approx(straight.finish_x)
    rng = np.random.default_rng(0)
    x, y = rng.uniform((-1.5, -4.0), (straight.finish_x + 0.5 * RUN_OUT, 4.0), (4000, 2)).T
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    there = turned.height_at(cos * x - sin * y, sin * x + cos * y)
    here = straight.height_at(x, y)
    assert np.mean(np.abs(there - here) > 1e-6) < 0.002  # edges themselves
    assert (here[x < FIRST_EDGE_X] == 0.0).all()
    if name in ("stones", "trench"):
        assert {float(low) for low in np.round(here, 3)} == {-TRENCH_DEPTH, 0.0}


def test_unknown_grounds_are_refused() -> None:
    with pytest.raises(ConfigError, match="no ground to jump over 'stone'"):
        jumped_ground("stone", 0)


class Obedient:
    """A point that goes ahead while it is told to jump, turns by what it is told, and slides on."""

    def __init__(self, turn_share: float = 1.0, slides_s: float = 0.0, **changes: Any) -> None:
        self._share, self._slides_s, self._changes = turn_share, slides_s, changes
        self._truth = MujocoRobot(setup_of(TerrainConfig(terrain="flat"), Trial.draw(0))).state

    def run(self, operator: WalkOperator) -> Iterator[WalkStep]:
        """Its motion, from a yaw of 0.04 rad on."""
        x = y = left_s = 0.0
        yaw = 0.04
        for step in count():
            speed = SPEED_MPS if left_s > 0.0 else 0.0
            velocity = speed * np.array([math.cos(yaw), math.sin(yaw), 0.0])
            truth = replace(
                self._truth,
                position_base_in_world=np.array([x, y, 0.3]),
                quaternion_base_in_world=quaternion_from_roll_pitch_yaw(*np.array([0.0, 0.0, yaw])),
                velocity_base_in_world=velocity,
            )
            wish = operator(step * POLICY_DT, truth)
            jumps = wish.mode == CommandMode.JUMP and step * POLICY_DT >= STANDS_S
            left_s = max(self._slides_s, POLICY_DT) if jumps else left_s - POLICY_DT
            given: dict[str, Any] = {
                "mode": ControllerMode.RUN if left_s > 0.0 else ControllerMode.STAND,
                "touched": False,
            }
            yield WalkStep(time_s=step * POLICY_DT, truth=truth, wish=wish, **given | self._changes)
            x, y = x + POLICY_DT * velocity[0], y + POLICY_DT * velocity[1]
            yaw += POLICY_DT * wish.turn_rps * self._share * jumps


@pytest.mark.parametrize("heading", [-20.0, 0.0, 10.0])
def test_the_error_of_a_heading_is_what_a_robot_lacks_of_the_turn(heading: float) -> None:
    angles = JumpAngles(heading_deg=heading)
    for share in (1.0, 0.8):
        done = run_jump(Obedient(share).run, 0, angles, 6.0)
        assert not done.cause
        lacks = abs(heading) * (1.0 - share)
        assert done.figures["heading_deg"] == pytest.approx(lacks, abs=0.5)


@pytest.mark.parametrize(("degrees", "share"), [(0.0, 1.0), (30.0, 0.866), (-30.0, 0.866)])
def test_a_ground_is_crossed_in_the_direction_in_which_it_leads(
    degrees: float, share: float
) -> None:
    done = run_jump(Obedient().run, 0, JumpAngles(askew_deg=degrees), 3.0)
    assert done.figures["time_s"] == pytest.approx(3.0 / SPEED_MPS / share, rel=0.05)


@pytest.mark.parametrize(
    ("change", "cause"),
    [({"touched": True}, "trunk_contact"), ({"mode": ControllerMode.STOPPED}, "stopped")],
)
def test_a_robot_that_cannot_go_on_has_failed(change: dict[str, Any], cause: str) -> None:
    assert run_jump(Obedient(**change).run, 0, JumpAngles(), 3.0).cause == cause


def test_who_slides_on_for_more_than_a_metre_has_not_stopped() -> None:
    for slides_s, cause in ((0.5, ""), (1.2, "too_far")):
        stopped = run_stop(Obedient(slides_s=slides_s).run, 1, jumps=True)
        assert (stopped.cause, stopped.figures["speed_mps"]) == (cause, pytest.approx(SPEED_MPS))
        assert (stopped.figures["way_m"] < STOP_WITHIN_M) == (not cause)


@pytest.mark.sample(2)
@pytest.mark.parametrize("robot", WALKS)
@pytest.mark.parametrize("heading", [-20.0, 20.0])
def test_a_robot_as_it_is_deployed_turns_while_it_jumps(robot: str, heading: float) -> None:
    trials = WalkTrials(
        robot=robot, grid=WALKING_GRID, model=walking_path(robot).resolve(),
        angles=JumpAngles(heading_deg=heading),
    )  # fmt: skip
    (done,) = WalkTrialTask(kind="jump", ground="plain", seeds=(7,), source=TrueHeightSource).run(
        trials
    )
    assert not done.cause
    assert vars(done)["figures"]["heading_deg"] < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("robot", WALKS)
def test_a_robot_as_it_is_deployed_stops_on_stairs_while_it_jumps(robot: str) -> None:
    """Its walking policy catches it: two of three stand; one of ten did where it was landed."""
    trials = WalkTrials(robot=robot, grid=WALKING_GRID, model=walking_path(robot))
    seeds = (65000, 65003, 65004)
    task = WalkTrialTask(kind="jump_stop", ground="stairs", seeds=seeds, source=TrueHeightSource)
    assert sum(not result.cause for result in task.run(trials)) >= 2
