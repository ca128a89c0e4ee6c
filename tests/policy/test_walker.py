"""A walking policy on the robot: the vector is that of its training, and it is asked in time."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples import ROBOT
from walking_policies import OURS, bearing, put_policy

from saltus.errors import ModelError
from saltus.policy.joints.footing import BEARS_NS, LONGEST_NS
from saltus.policy.joints.policy import JointPolicy
from saltus.policy.joints.walker import (
    CAUGHT_MPS,
    CAUGHT_NS,
    RESTING_RPS,
    RISE_NS,
    STILL_NS,
    STIRRED_NS,
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


@pytest.mark.parametrize(
    ("velocity", "turning", "is_stirred"),
    [
        (AHEAD, 0.9 * RESTING_RPS, True),
        (AHEAD, 1.1 * RESTING_RPS, False),
        ((0.05, 0.0, 0.0), 0.0, False),
        ((0.0, 0.0, 0.5), 0.0, True),
    ],
)
def test_only_a_robot_that_rests_although_it_is_to_move_is_stirred(
    policy: Noted, velocity: tuple[float, float, float], turning: float, is_stirred: bool
) -> None:
    walker, twin = Walker(ROBOT, policy), Walker(ROBOT, policy)
    first, joints = risen(walker, velocity), np.full(12, turning)
    risen(twin, velocity)
    targets = []
    for step in range(first, first + 4 * (STILL_NS + STIRRED_NS) // STEP_NS):
        given = PlannerDecision(
            state=state(step, joint_velocity=joints), heights=LEVEL, velocity=velocity
        )
        plans = [each.plan(given).joint_position for each in (walker, twin)]
        np.testing.assert_array_equal(*plans)  # of equal robots, all draws are equal
        targets.append(plans[0])
    changed = np.abs(np.diff(targets, axis=0)).max(-1) > 1e-3
    still = STILL_NS // STEP_NS - 3  # the policy acted first before these steps
    assert not changed[:still].any()
    assert changed[still:].any() == is_stirred
    if is_stirred:  # again and again, with rests between
        period = (STILL_NS + STIRRED_NS) // STEP_NS
        shares = [changed[k * period : (k + 1) * period].mean() for k in range(4)]
        assert 0.2 < min(shares) < max(shares) < 0.5


def test_a_robot_that_is_stirred_stops_at_once(policy: Noted) -> None:
    walker = Walker(ROBOT, policy)
    first = risen(walker)
    stirred = first + (STILL_NS + STIRRED_NS // 2) // STEP_NS
    for step in range(first, stirred + 50):
        velocity = AHEAD if step < stirred else AT_REST
        plan = walker.plan(PlannerDecision(state=state(step), heights=LEVEL, velocity=velocity))
        if step == stirred + 1:
            stands = plan.joint_position
    np.testing.assert_allclose(plan.joint_position, stands, atol=1e-6)


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


@pytest.mark.parametrize("speed", [0.0, 0.5, 1.4, 3.0])
@pytest.mark.parametrize("velocity", [AT_REST, AHEAD])
def test_a_robot_that_jumps_is_caught_at_once_and_led_on(
    policy: Noted, speed: float, velocity: PlanarVelocity
) -> None:
    """Asked for a slow walk first, no faster than it is, and soon for what is told."""
    walker, first = Walker(ROBOT, policy), 100
    policy.given.clear()
    for step in range(first, first + 90):
        mode = ControllerMode.RUN if step == first else ControllerMode.WALK
        here = state(step, mode, velocity_base_in_world=np.array([speed, 0.0, 0.2]))
        walker.plan(PlannerDecision(state=here, heights=LEVEL, velocity=velocity))
        assert walker.slows(here) or step > first
    ahead, aside = (np.array([vector[at] for vector in policy.given]) for at in (6, 7))
    is_led = np.arange(len(ahead)) * 20_000_000 < CAUGHT_NS
    assert is_led.any()
    assert speed == 0.0 or not is_led.all()  # one at rest may stand before
    slow = max(min(speed, CAUGHT_MPS), velocity[0])
    assert ahead[0] == pytest.approx(slow)
    assert np.all(np.diff(ahead) <= 0.0)
    np.testing.assert_allclose(ahead, np.where(is_led, slow, velocity[0]), atol=1e-6)
    np.testing.assert_allclose(aside, velocity[1], atol=1e-6)


@pytest.mark.parametrize("speed", [0.0, 0.1, 0.3, 2.0])
def test_it_comes_to_a_stand_before_it_rests_and_not_later_than_said(
    policy: Noted, speed: float
) -> None:
    walker = Walker(ROBOT, policy)
    known = {
        "velocity_base_in_world": np.array([0.0, speed, 0.0]),
        "joint_torque": bearing(ROBOT.stand_pose, np.full(4, 0.25)),
    }
    first = step = risen(walker)
    while walker.slows(state(step, **known)):
        walker.plan(PlannerDecision(state=state(step, **known), heights=LEVEL, velocity=AT_REST))
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
