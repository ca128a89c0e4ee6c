"""Trials of a walking policy: grounds, what the judge says of a motion,
and a robot as it is deployed.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from walking_policies import put_policy

from saltus.config import TerrainConfig
from saltus.constants import POLICY_DT
from saltus.controller.tick import CompiledTickLaw
from saltus.drive.wish import Wish
from saltus.errors import ConfigError
from saltus.policy.evaluation import walking_trials as trials
from saltus.policy.evaluation.walking_conditions import WalkConditions
from saltus.policy.evaluation.walking_errands import LINE_M, LINE_RAD, run_line, run_route, run_stop
from saltus.policy.evaluation.walking_grounds import (
    DRILL_GROUNDS,
    FINISH_X,
    GROUNDS,
    WIDTH_M,
    drill_ground,
    make_walk_ground,
)
from saltus.policy.evaluation.walking_routes import ROUTES, make_route
from saltus.policy.evaluation.walks import TrueHeightSource, WalkOperator, WalkStep, walk_steps
from saltus.policy.joints.policy import JointPolicy
from saltus.policy.joints.walker import Walker
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import STANCE_M
from saltus.trial import Trial, is_upright
from saltus.wire.messages import CommandMode, ControllerMode

STEPS = {"stairs": (14, 0.15), "hurdles": (7, 0.15), "irregular": (11, 0.20)}


@pytest.mark.parametrize("name", GROUNDS)
@pytest.mark.parametrize("seed", range(4))
def test_a_ground_reaches_ten_metres_and_is_as_high_as_said(name: str, seed: int) -> None:
    terrain = make_walk_ground(name, seed)
    x = np.linspace(0.0, FINISH_X + STANCE_M, 500)
    assert all(terrain.arrays.covers(float(each), 0.0) for each in x)
    heights = terrain.height_at(x, np.zeros_like(x))
    assert heights[0] == pytest.approx(0.0, abs=0.01)
    assert terrain.finish_x == FINISH_X
    if name in STEPS:
        steps, rise = STEPS[name]
        assert np.abs(np.diff(heights)).max() <= rise + 1e-9
        if name != "hurdles":
            assert heights.max() <= steps * rise + 1e-9
    if name == "ramps":
        slopes = np.abs(np.diff(heights) / np.diff(x))
        assert np.percentile(slopes, 80) == pytest.approx(math.tan(math.radians(20.0)), rel=0.02)


@pytest.mark.parametrize("name", DRILL_GROUNDS)
def test_robots_that_leave_the_field_of_a_drill_do_not_fall(name: str) -> None:
    terrain, rng = drill_ground(name, 3), np.random.default_rng(0)
    for x, y in rng.uniform((-8.0, -12.0), (18.0, 12.0), (200, 2)):
        assert terrain.arrays.covers(float(x), float(y))


@pytest.mark.parametrize("seed", range(10))
def test_robots_are_set_down_on_level_ground(seed: int) -> None:
    """Else one foot alone may be above a block, on which the robot falls over."""
    starts = {
        **{name: make_walk_ground(name, seed) for name in GROUNDS},
        **{f"{name}, drilled": drill_ground(name, seed) for name in DRILL_GROUNDS},
        **{name: make_route(name, seed).terrain for name in ROUTES},
    }
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 60), np.linspace(-0.3, 0.3, 40))
    for name, terrain in starts.items():
        assert np.abs(terrain.height_at(x.ravel(), y.ravel())).max() < 0.011, name


def test_unknown_grounds_are_refused() -> None:
    with pytest.raises(ConfigError, match="no ground 'stair'"):
        make_walk_ground("stair", 0)
    with pytest.raises(ConfigError, match="no ground for drills 'stairs'"):
        drill_ground("stairs", 0)


class Kinematic:
    """A robot that does exactly what it is told, with an error, from when it has got up."""

    def __init__(
        self,
        tmp_path: Path,
        error: tuple[float, float, float] = (0.0, 0.0, 0.0),
        stops_s: float = 0.0,
    ) -> None:
        model = put_policy(tmp_path / "walk.onnx")
        setup = trials.WalkTrials(robot="go1", grid="scan", model=model).setup(
            make_walk_ground("plain", 0), 0
        )
        walker = Walker(setup.robot, JointPolicy(model))
        steps = walk_steps(
            setup,
            [walker],
            TrueHeightSource(setup),
            lambda *_: Wish(),
            CompiledTickLaw(setup.robot),
        )
        self._truth, self._error, self._stops_s = next(steps).truth, np.array(error), stops_s

    def run(self, operator: WalkOperator, **changes: Any) -> Iterator[WalkStep]:
        """Its motion."""
        x = y = yaw = told_s = 0.0
        last = Wish()
        for step in count():
            time_s = step * POLICY_DT
            truth = replace(
                self._truth,
                position_base_in_world=np.array([x, y, 0.3]),
                quaternion_base_in_world=quaternion_from_roll_pitch_yaw(*np.array([0.0, 0.0, yaw])),
            )
            wish = asks = operator(time_s, truth)
            if asks.mode == CommandMode.WALK:
                last, told_s = asks, time_s
            elif time_s - told_s < self._stops_s:
                wish = last  # it slides on
            walks = wish.mode == CommandMode.WALK and time_s >= trials.BEGINS_S
            asked = np.array([wish.ahead_mps, wish.left_mps, wish.turn_rps])
            ahead, left, turn = (asked + self._error) * walks
            cos, sin = math.cos(yaw), math.sin(yaw)
            velocity = np.array([cos * ahead - sin * left, sin * ahead + cos * left, 0.0])
            truth = replace(
                truth,
                velocity_base_in_world=velocity,
                angular_velocity_base=np.array([0.0, 0.0, turn]),
            )
            given: dict[str, Any] = {
                "mode": ControllerMode.WALK if walks else ControllerMode.STAND,
                "touched": False,
            }
            yield WalkStep(time_s=time_s, truth=truth, wish=asks, **given | changes)
            x, y = x + POLICY_DT * velocity[0], y + POLICY_DT * velocity[1]
            yaw += POLICY_DT * turn


def test_who_does_what_it_is_told_crosses_and_errors_are_those_made(tmp_path: Path) -> None:
    obedient, error = Kinematic(tmp_path), (0.05, -0.03, 0.06)
    crossed = trials.cross(obedient.run, 4)
    assert (crossed.cause, crossed.distance_m) == ("", pytest.approx(FINISH_X, abs=0.02))
    assert crossed.time_s * crossed.speed_mps == pytest.approx(FINISH_X, abs=0.05)
    drilled = trials.run_drill(obedient.run, 4)
    assert drilled.errors == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert (drilled.stop_m, drilled.stop_s) == pytest.approx((0.0, 0.0), abs=0.02)
    assert drilled.turn_s == pytest.approx(math.pi, abs=0.02)
    worse = trials.run_drill(Kinematic(tmp_path, error).run, 4)
    assert worse.errors == pytest.approx(np.abs(error), abs=1e-9)


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"touched": True}, "trunk_contact"),
        ({"mode": ControllerMode.STOPPED}, "stopped"),
        ({"mode": ControllerMode.DAMP}, "stopped"),
    ],
)
def test_a_robot_that_cannot_go_on_has_failed(
    tmp_path: Path, change: dict[str, Any], cause: str
) -> None:
    robot = Kinematic(tmp_path)
    for judge in (trials.cross, trials.run_drill):
        assert judge(lambda operator: robot.run(operator, **change), 0).cause == cause


def test_who_does_what_it_is_told_does_all_errands(tmp_path: Path) -> None:
    robot, seed = Kinematic(tmp_path), 1
    stopped = run_stop(robot.run, seed)
    assert (stopped.cause, stopped.figures["way_m"]) == ("", pytest.approx(0.0, abs=0.02))
    lined = run_line(robot.run, seed)
    assert not lined.cause
    assert lined.figures["offset_m"] < LINE_M
    assert lined.figures["heading_deg"] < math.degrees(LINE_RAD)
    for name in ROUTES:
        led = run_route(robot.run, seed, make_route(name, seed))
        assert (led.cause, led.figures["goals"]) == ("", len(make_route(name, seed).goals))


def test_errands_are_not_done_by_who_slides_or_drifts(tmp_path: Path) -> None:
    sliding = Kinematic(tmp_path, stops_s=2.0)
    stopped = run_stop(sliding.run, 0)
    assert (stopped.cause, stopped.figures["way_m"]) == ("too_far", pytest.approx(2.0, abs=0.05))
    drifting = Kinematic(tmp_path, (0.0, 0.8, 0.0))
    assert run_line(drifting.run, 0).cause == "time_limit"
    assert run_route(drifting.run, 0, make_route("landing", 0)).cause == "left"


@pytest.mark.parametrize("name", ROUTES)
@pytest.mark.parametrize("seed", range(4))
def test_there_is_ground_at_all_goals_of_a_route_and_it_is_as_long_as_said(
    name: str, seed: int
) -> None:
    drawn = make_route(name, seed)
    assert all(drawn.terrain.arrays.covers(*goal) for goal in ((0.0, 0.0), *drawn.goals))
    low, high = {"landing": (4.0, 8.0), "course": (22.0, 29.0), "arena": (35.0, 45.0)}[name]
    assert low < drawn.length_m < high
    assert len(drawn.goals) == {"landing": 5, "course": 11, "arena": 5}[name]
    assert drawn == make_route(name, seed)


def test_conditions_change_what_they_name_and_nothing_else() -> None:
    changed = WalkConditions(friction=0.4, camera_late_s=0.15).trial(5)
    assert changed == replace(Trial.draw(5), friction=0.4, camera_delay_s=0.15)
    assert WalkConditions(push_ns=20.0).trial(5) == Trial.draw(5)


@pytest.mark.parametrize("robot", ["go1", "go2"])
@pytest.mark.parametrize("late_s", [0.05, 0.15])
def test_images_are_as_late_as_a_condition_says(tmp_path: Path, robot: str, late_s: float) -> None:
    model, flat = put_policy(tmp_path / "walk.onnx"), make_terrain(TerrainConfig(terrain="flat"))
    conditions = WalkConditions(camera_late_s=late_s)
    tried = trials.WalkTrials(robot=robot, grid="scan", model=model, conditions=conditions)
    setup = tried.setup(flat, 0)
    delivered = setup.trial.applied_to(setup.profile).camera_chain.latency
    assert float(delivered.latency) == pytest.approx(late_s)


def test_images_that_come_at_once_cannot_be_late(tmp_path: Path) -> None:
    model, flat = put_policy(tmp_path / "walk.onnx"), make_terrain(TerrainConfig(terrain="flat"))
    tried = trials.WalkTrials(robot="go1", grid="scan", model=model, profile="ideal")
    tried.setup(flat, 0)
    late = replace(tried, conditions=WalkConditions(camera_late_s=0.15))
    with pytest.raises(ConfigError, match="come at once"):
        late.setup(flat, 0)


def test_a_push_gives_the_trunk_its_impulse(tmp_path: Path) -> None:
    model = put_policy(tmp_path / "walk.onnx")
    flat = replace(make_terrain(TerrainConfig(terrain="flat")), start_x=-1.0, finish_x=-0.9)
    setup = trials.WalkTrials(robot="go1", grid="scan", model=model).setup(flat, 0)
    walker = Walker(setup.robot, JointPolicy(model))

    def aside(push_ns: float) -> float:
        steps = walk_steps(
            setup, [walker], TrueHeightSource(setup), lambda *_: Wish(),
            CompiledTickLaw(setup.robot), push_ns,
        )  # fmt: skip
        return max(abs(step.truth.velocity_base_in_world[1]) for step in islice(steps, 30))

    assert aside(20.0) > aside(0.0) + 0.3  # 20 Ns on 12 kg, which the feet hold back in part


def test_who_drifts_off_or_does_not_come_is_told_apart(tmp_path: Path) -> None:
    assert trials.cross(Kinematic(tmp_path, (0.0, 1.5, 0.0)).run, 0).cause == "left"
    assert trials.cross(Kinematic(tmp_path, (-0.5, 0.0, 0.0)).run, 0).cause == "time_limit"
    assert WIDTH_M > 2.0


def test_a_robot_as_it_is_deployed_gets_up_and_holds_its_pose(tmp_path: Path) -> None:
    settings = trials.WalkTrials(robot="go1", grid="scan", model=put_policy(tmp_path / "w.onnx"))
    setup = settings.setup(make_walk_ground("rubble", 1), 1)
    walker = Walker(setup.robot, JointPolicy(settings.model))
    told = Wish(mode=CommandMode.WALK)
    steps = list(
        islice(
            walk_steps(
                setup,
                [walker],
                TrueHeightSource(setup),
                lambda *_: told,
                CompiledTickLaw(setup.robot),
            ),
            200,
        )
    )
    modes = [step.mode for step in steps]
    assert modes[100:] == [modes[100], *[ControllerMode.WALK] * 99]
    assert set(modes[:100]) == {ControllerMode.STAND}
    heights = [step.truth.position_base_in_world[2] for step in steps]
    assert 0.2 < min(heights) < max(heights) < 0.35
    assert all(is_upright(step.truth.quaternion_base_in_world) for step in steps)
    assert not any(step.touched for step in steps)
