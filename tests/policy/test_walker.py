"""A walking policy on the robot: the vector is that of its training, and it is asked in time."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples import ROBOT
from walking_policies import OURS, bearing, put_policy

from saltus.drive.goals import Goals
from saltus.errors import ModelError
from saltus.policy.joints.footing import BEARS_NS, LONGEST_NS
from saltus.policy.joints.policy import JointPolicy
from saltus.policy.joints.stuck import BACK_NS, BACK_SPEED, MEMORY_S, STUCK_SHARE, StuckWatch
from saltus.policy.joints.walker import (
    CAUGHT_MPS,
    CAUGHT_NS,
    RISE_NS,
    STOP_NS,
    Walker,
)
from saltus.policy.mover import AT_REST, PlanarVelocity, PlannerDecision
from saltus.policy.walking.description import SIZE
from saltus.policy.walking.settings import GroundSettings, WalkSettings, WalkTrainSettings
from saltus.policy.walking.train import make_walk_engine
from saltus.policy.walking.walk_env import WalkEnv
from saltus.robots.loading import load_robot
from saltus.states import standing_state
from saltus.wire.messages import ControllerMode, RobotState

STEP_NS = 10_000_000
LEVEL = np.full(187, -0.3)
AHEAD = (0.5, 0.1, -0.2)


class Noted(JointPolicy):
    """A policy that notes what it is given."""

    def __init__(self, path: Path) -> None:
        self.given: list[Any] = []
        super().__init__(path)

    def __call__(self, vectors: Any) -> Any:
        """See `JointPolicy`."""
        self.given.append(np.array(vectors[0]))
        return super().__call__(vectors)


@pytest.fixture
def policy(tmp_path: Path) -> Noted:
    return Noted(put_policy(tmp_path / "walk.onnx"))


def state(step: int, mode: ControllerMode = ControllerMode.WALK, **changes: Any) -> RobotState:
    standing = replace(standing_state(ROBOT), base_height=0.27, mode=mode)
    return replace(standing, step=step, time_ns=step * STEP_NS, **changes)


def risen(walker: Walker, velocity=AHEAD) -> int:
    """Brings it to where the policy acts; returns the next step."""
    steps = RISE_NS // STEP_NS + 1
    for step in range(steps):
        mode = ControllerMode.WALK if step else ControllerMode.STAND
        walker.plan(PlannerDecision(state=state(step, mode), heights=LEVEL, velocity=velocity))
    return steps


def test_robot_and_training_make_the_same_vector_of_the_same_robot(policy: Noted) -> None:
    config = WalkTrainSettings(
        robot="go1", robots=6, env=WalkSettings(ground=GroundSettings(shares={"plain": 1.0}))
    )
    env = WalkEnv(make_walk_engine(load_robot("go1"), config, "cpu", threads=1), config.env, seed=5)
    exact = env.critic.numpy()[:, :SIZE]  # without errors of sensors and scan
    qpos, qvel = np.array(env._engine.qpos), np.array(env._engine.qvel)
    for robot, expected in enumerate(exact):
        walker, told = Walker(ROBOT, policy), env.memory.command[robot].tolist()
        step = risen(walker, tuple(told))
        known = state(
            step + 2,
            quaternion_base_in_world=qpos[robot, 3:7],
            angular_velocity_base=qvel[robot, 3:6],
            joint_position=qpos[robot, 7:],
            joint_velocity=qvel[robot, 6:],
        )
        walker.plan(PlannerDecision(state=known, heights=LEVEL, velocity=tuple(told)))
        np.testing.assert_allclose(policy.given[-1][:45], expected[:45], atol=1e-5)
        np.testing.assert_allclose(policy.given[-1][45:], 0.3 - 0.5, atol=1e-6)


def test_it_gets_up_to_its_pose_and_holds_still_until_the_controller_follows(
    policy: Noted,
) -> None:
    walker, away = Walker(ROBOT, policy), ROBOT.stand_pose + 0.1
    policy.given.clear()
    for step in range(5):  # not followed yet
        held = walker.plan(
            PlannerDecision(
                state=state(step, ControllerMode.STAND, joint_position=away),
                heights=LEVEL,
                velocity=AHEAD,
            )
        )
        np.testing.assert_array_equal(held.joint_position, away)
    distances = []
    for step in range(5, 4 + RISE_NS // STEP_NS):
        plan = walker.plan(
            PlannerDecision(state=state(step, joint_position=away), heights=LEVEL, velocity=AHEAD)
        )
        distances.append(np.abs(plan.joint_position - OURS.pose).max())
    assert (np.diff(distances) <= 0.0).all()
    assert np.abs(np.diff(distances)).max() < 0.05
    assert distances[-1] < 0.01
    assert not policy.given
    np.testing.assert_array_equal(plan.kp, OURS.kp)
    np.testing.assert_array_equal(plan.kd, OURS.kd)


def asked_for(policy: Noted, walker: Walker, velocity: PlanarVelocity, share: float) -> Any:
    """Velocities that a policy is asked for in 4 s in which a robot follows its command by a share,
    shape (n, 3).
    """
    first = risen(walker, velocity)
    policy.given.clear()
    moving = {
        "velocity_base_in_world": share * np.array([*velocity[:2], 0.0]),
        "angular_velocity_base": share * np.array([0.0, 0.0, velocity[2]]),
    }
    for step in range(first, first + 400):
        walker.plan(PlannerDecision(state=state(step, **moving), heights=LEVEL, velocity=velocity))
    return np.array(policy.given)[:, 6:9]


STUCK_S = -MEMORY_S * np.log(STUCK_SHARE)
"""After which a robot that stands is stuck."""


@pytest.mark.parametrize("velocity", [AHEAD, (0.0, 0.0, 0.5), (-0.2, 0.0, 0.0), (1.0, 0.0, 0.0)])
@pytest.mark.parametrize("share", [-0.2, 0.0])
def test_a_robot_that_does_not_follow_its_command_is_led_the_other_way(
    policy: Noted, velocity: PlanarVelocity, share: float
) -> None:
    """Again and again, with as long a time between in which it is led as it is told."""
    asked, told = asked_for(policy, Walker(ROBOT, policy), velocity, share), np.array(velocity)
    way = np.where([True, True, not told[:2].any()], told, 0.0)
    back = -way * min(1.0, BACK_SPEED / np.linalg.norm(way))
    is_back = np.abs(asked - back).max(-1) < 1e-6
    np.testing.assert_allclose(asked[~is_back], told * np.ones((sum(~is_back), 1)), atol=1e-6)
    lengths = np.diff(np.flatnonzero(np.diff(is_back))) * 2e-9 * STEP_NS  # of each turn in which
    backs, between = lengths[::2], lengths[1::2]  # it is led back, and as it is told
    assert len(backs) == len(between) + 1 == 2
    assert np.argmax(is_back) * 2e-9 * STEP_NS == pytest.approx(STUCK_S, abs=0.05)
    np.testing.assert_allclose(backs, 1e-9 * BACK_NS, atol=0.025)
    np.testing.assert_allclose(between, STUCK_S, atol=0.05)


@pytest.mark.parametrize(
    ("velocity", "share"),
    [
        (AHEAD, 1.1 * STUCK_SHARE),
        (AHEAD, 1.2),
        ((9.0, 0.0, 0.0), 1.1 * STUCK_SHARE * OURS.command_high[0] / 9.0),  # as fast as it can
        ((0.0, 0.0, 0.5), 1.1 * STUCK_SHARE),
        ((0.05, 0.0, 0.0), 0.0),
        (AT_REST, 0.0),
    ],
)
def test_one_that_follows_or_is_to_stand_is_led_as_it_is_told(
    policy: Noted, velocity: PlanarVelocity, share: float
) -> None:
    asked = asked_for(policy, Walker(ROBOT, policy), velocity, share)
    np.testing.assert_allclose(asked, OURS.obeyed(velocity) * np.ones((len(asked), 1)), atol=1e-6)


def led(commands: Any, moves: float, start: float = 0.0) -> Any:
    """Velocities that a robot is asked for by commands, shape (n, 3), 20 ms apart; NaN where it is
    not led. It comes to the speed asked for with a time constant of `moves` [s].
    """
    watch, velocity, asked = StuckWatch(), np.array([start, 0.0, 0.0]), []
    for step, command in enumerate(commands):
        if np.isnan(command).any():
            continue
        here = replace(
            standing_state(ROBOT),
            time_ns=step * 2 * STEP_NS,
            velocity_base_in_world=np.array([velocity[0], velocity[1], 0.0]),
            angular_velocity_base=np.array([0.0, 0.0, velocity[2]]),
        )
        asked.append(watch.lead(here, command))
        velocity = velocity + (asked[-1] - velocity) * min(1.0, 0.02 / moves)
    return np.array(asked)


@pytest.mark.parametrize("changes_s", [0.3, 0.6, 0.9, 1.1, 1.5])
@pytest.mark.parametrize("then", [-0.5, -0.2, 0.0])
@pytest.mark.parametrize("moves", [0.2, 1e9])
def test_a_robot_that_is_told_otherwise_does_that_at_once(
    changes_s: float, then: float, moves: float
) -> None:
    """It has its time then, if it moved, was stuck or was led back."""
    commands = np.zeros((200, 3))
    at = round(changes_s / 0.02)
    commands[:at, 0], commands[at:, 0] = 0.5, then
    asked = led(commands, moves)
    np.testing.assert_array_equal(asked[at : at + 40], commands[at : at + 40])


@pytest.mark.parametrize("swings_s", [0.1, 0.3, 0.6, 1.2])
@pytest.mark.parametrize("begins_s", [0.5, 1.1, 1.3])
def test_a_stuck_robot_whose_command_swings_round_is_not_led_against_it(
    begins_s: float, swings_s: float
) -> None:
    share = np.clip((0.02 * np.arange(200) - begins_s) / swings_s, 0.0, 1.0)
    commands = np.zeros((200, 3))
    commands[:, 0], commands[:, 1] = 0.5 * np.cos(np.pi * share), 0.5 * np.sin(np.pi * share)
    asked = led(commands, 1e9)
    arrived = round((begins_s + swings_s) / 0.02) + 1
    assert (asked[arrived : arrived + 20, 0] < 0.0).all()


@pytest.mark.parametrize("turns", [0.3, 0.8])
@pytest.mark.parametrize("every_s", [0.1, 0.5, 5.0])
def test_the_way_of_a_robot_that_is_to_go_and_to_turn_is_what_counts(
    turns: float, every_s: float
) -> None:
    commands = np.tile([0.5, 0.0, turns], (100, 1))
    commands[np.arange(100) % round(2.0 * every_s / 0.02) >= round(every_s / 0.02), 2] *= -1.0
    watches, time_s = (StuckWatch(), StuckWatch()), 0.02 * np.arange(100)
    standing = replace(standing_state(ROBOT), velocity_base_in_world=np.zeros(3))
    for moves, watch in zip((0.0, 0.5), watches, strict=True):
        asked = []
        for now, command in zip(time_s, commands, strict=True):
            here = replace(  # turns as told where it does not go, and not at all where it goes
                standing,
                time_ns=round(1e9 * now),
                velocity_base_in_world=np.array([moves, 0.0, 0.0]),
                angular_velocity_base=np.array([0.0, 0.0, 0.0 if moves else command[2]]),
            )
            asked.append(watch.lead(here, command))
        is_back = np.array(asked)[:, 0] < 0.0
        assert is_back.any() == (moves == 0.0)
        if moves == 0.0:
            assert time_s[np.argmax(is_back)] == pytest.approx(STUCK_S, abs=0.05)


@pytest.mark.parametrize("before", [1.2, 1.0, 0.5])
@pytest.mark.parametrize("after", [-0.2, -0.3, -0.8, 0.2])
@pytest.mark.parametrize("moves", [0.1, 0.3])
def test_a_robot_that_obeys_is_never_led_another_way(
    before: float, after: float, moves: float
) -> None:
    for at in range(20, 90, 7):
        commands = np.zeros((200, 3))
        commands[:at, 0], commands[at:, 0] = before, after
        np.testing.assert_array_equal(led(commands, moves, before), commands)


@pytest.mark.parametrize("waits", [10, 35, 60])
def test_time_in_which_a_robot_was_not_led_does_not_count(waits: int) -> None:
    """As while its feet are let down, or its heights are gone."""
    commands = np.tile([0.5, 0.0, 0.0], (200, 1))
    commands[60 : 60 + waits] = np.nan
    assert (led(commands, 0.4)[:, 0] > 0.0).all()


@pytest.mark.parametrize("start", range(6))
def test_a_robot_that_comes_no_farther_is_led_back_and_reaches_its_goal(start: int) -> None:
    """It stands in front of something until it has come back."""
    rng, watch = np.random.default_rng(start), StuckWatch()
    goals = Goals([tuple(rng.uniform(2.0, 3.0, 2))], 0.6, 0.8)
    stops_s, place, heading, backs = rng.uniform(2.0, 3.5), np.zeros(2), 0.7, 0
    time_s, since_s, ahead_mps, turn_rps = 0.0, 0.0, 0.0, 0.0
    while goals.left:
        assert time_s < 60.0, "it goes on and on"
        wish = goals.lead(place, heading)
        is_stopped = time_s > stops_s and not backs
        since_s = since_s if is_stopped else time_s
        here = replace(
            standing_state(ROBOT),
            time_ns=round(1e9 * time_s),
            velocity_base_in_world=np.array([ahead_mps, 0.0, 0.0]),
            angular_velocity_base=np.array([0.0, 0.0, turn_rps]),
        )
        wished = np.array([wish.ahead_mps, wish.left_mps, wish.turn_rps])
        ahead_mps, _, turn_rps = watch.lead(here, wished)
        if ahead_mps < 0.0:
            assert backs or time_s - since_s > STUCK_S - 0.05
            backs += 1
        elif is_stopped:
            ahead_mps = turn_rps = 0.0
        ahead = np.array([np.cos(heading), np.sin(heading)])
        place, heading = place + 0.01 * ahead_mps * ahead, heading + 0.01 * turn_rps
        time_s += 0.01
    assert backs == pytest.approx(BACK_NS // STEP_NS, abs=2)


@pytest.mark.parametrize("told", [AT_REST, (0.0, 0.0, 0.05)])
def test_a_robot_that_is_led_back_stands_at_once_when_it_is_told(
    policy: Noted, told: PlanarVelocity
) -> None:
    walker = Walker(ROBOT, policy)
    first = risen(walker)
    stops = first + (round(1e9 * STUCK_S) + BACK_NS // 2) // STEP_NS
    for step in range(first, stops + 50):
        velocity = AHEAD if step < stops else told
        walker.plan(PlannerDecision(state=state(step), heights=LEVEL, velocity=velocity))
        if step == stops - 1:
            assert policy.given[-1][6] < 0.0
            policy.given.clear()
    np.testing.assert_allclose(
        np.array(policy.given)[:, 6:9], np.array(told) * np.ones((len(policy.given), 1)), atol=1e-6
    )


@pytest.mark.parametrize(("every", "asked"), [(1, 50), (2, 50), (3, 34)])
def test_the_policy_is_asked_at_its_rate_however_often_states_come(
    policy: Noted, every: int, asked: int
) -> None:
    walker = Walker(ROBOT, policy)
    first = risen(walker)
    policy.given.clear()
    for step in range(first, first + 100, every):
        walker.plan(PlannerDecision(state=state(step), heights=LEVEL, velocity=AHEAD))
    assert abs(len(policy.given) - asked) <= 1


def test_targets_are_the_pose_and_the_scaled_action_and_the_next_vector_has_it(
    tmp_path: Path,
) -> None:
    action = np.linspace(-1.0, 1.0, 12)
    policy = Noted(put_policy(tmp_path / "walk.onnx", action=action.tolist()))
    walker = Walker(ROBOT, policy)
    first = risen(walker)
    for step in range(first, first + 6):
        plan = walker.plan(PlannerDecision(state=state(step), heights=LEVEL, velocity=AHEAD))
    np.testing.assert_allclose(plan.joint_position, OURS.pose + 0.25 * action, atol=1e-6)
    np.testing.assert_allclose(policy.given[-1][33:45], action, atol=1e-6)
    np.testing.assert_allclose(policy.given[-1][6:9], AHEAD, atol=1e-6)


def test_commands_beyond_what_was_trained_are_cut_off(policy: Noted) -> None:
    for velocity in ((9.0, 9.0, 9.0), (-9.0, -9.0, -9.0)):
        walker = Walker(ROBOT, policy)
        step = risen(walker, velocity)
        walker.plan(PlannerDecision(state=state(step + 2), heights=LEVEL, velocity=velocity))
        end = OURS.command_high if velocity[0] > 0.0 else OURS.command_low
        np.testing.assert_allclose(policy.given[-1][6:9], end, atol=1e-6)


@pytest.mark.parametrize("stands", [0, 10, 22, 100])
@pytest.mark.parametrize("speed", [0.0, 0.5, 1.4, 3.0])
@pytest.mark.parametrize("velocity", [AT_REST, AHEAD])
def test_a_robot_that_jumps_is_caught_at_once_and_led_on_until_all_feet_stand(
    policy: Noted, speed: float, velocity: PlanarVelocity, stands: int
) -> None:
    """Asked for a slow walk first, no faster than it is, and soon for what is told."""
    walker, first, slowing = Walker(ROBOT, policy), 100, []
    policy.given.clear()
    for step in range(first, first + 94):
        mode = ControllerMode.RUN if step == first else ControllerMode.WALK
        now = speed if step == first else 0.1 * speed  # slow at once, for a moment or for good
        here = state(
            step, mode, velocity_base_in_world=np.array([now, 0.0, 0.2]),
            leg_trusted=np.array([True, step >= first + stands, True, True]),
        )  # fmt: skip
        walker.plan(PlannerDecision(state=here, heights=LEVEL, velocity=velocity))
        slowing.append(walker.slows(here))
    ahead, aside = (np.array([vector[at] for vector in policy.given]) for at in (6, 7))
    led_ns = np.clip(stands * STEP_NS, *CAUGHT_NS)
    is_led = np.arange(len(ahead)) * 20_000_000 < led_ns
    assert slowing[0]
    assert speed == 0.0 or all(slowing[: int(led_ns) // STEP_NS])
    assert is_led.any()
    assert speed == 0.0 or not is_led.all()  # one at rest may stand before
    slow = max(min(speed, CAUGHT_MPS), velocity[0])
    assert ahead[0] == pytest.approx(slow)
    assert np.all(np.diff(ahead) <= 0.0)
    np.testing.assert_allclose(ahead, np.where(is_led, slow, velocity[0]), atol=1e-6)
    np.testing.assert_allclose(aside, velocity[1], atol=1e-6)


@pytest.mark.parametrize("coasts", [0, 1, 4])
@pytest.mark.parametrize("speed", [0.0, 0.1, 0.3, 2.0])
def test_it_comes_to_a_stand_before_it_rests_and_not_later_than_said(
    policy: Noted, speed: float, coasts: int
) -> None:
    """Also where plans were late meanwhile, for some steps."""
    walker = Walker(ROBOT, policy)
    known = {
        "velocity_base_in_world": np.array([0.0, speed, 0.0]),
        "joint_torque": bearing(ROBOT.stand_pose, np.full(4, 0.25)),
    }
    first = step = risen(walker)

    def here() -> RobotState:
        late = 2 <= step - first < 2 + coasts
        return state(step, ControllerMode.COAST if late else ControllerMode.WALK, **known)

    while walker.slows(here()):
        walker.plan(PlannerDecision(state=here(), heights=LEVEL, velocity=AT_REST))
        step += 1
    least, most = (ns // STEP_NS for ns in STOP_NS)
    expected = least + BEARS_NS // STEP_NS if speed < 0.15 else most + LONGEST_NS // STEP_NS
    assert step - first == expected
    assert not walker.slows(state(first, ControllerMode.LANDING))


def test_a_policy_of_another_robot_or_none_is_refused(tmp_path: Path) -> None:
    other = JointPolicy(put_policy(tmp_path / "go2.onnx", replace(OURS, robot="go2")))
    with pytest.raises(ModelError, match="walks a 'go2', not a 'go1'"):
        Walker(ROBOT, other)
    with pytest.raises(ModelError, match="description"):
        JointPolicy(put_policy(tmp_path / "bare.onnx", describes_itself=False))
