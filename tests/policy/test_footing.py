"""Feet that hang are let down before a walking robot rests; those that stand stay."""

from dataclasses import replace

import numpy as np
import pytest
from samples import KINEMATICS, ROBOT
from walking_policies import bearing

from saltus.arrays import Floats
from saltus.policy.joints.footing import BEARS_NS, LONGEST_NS, LOWERING_MPS, Footing
from saltus.states import standing_state
from saltus.wire.messages import RobotState

STEP_NS = 10_000_000


def standing(step: int, feet: Floats, shares: Floats) -> RobotState:
    """A level robot with feet at places of its base, shape (4, 3) [m], by shares of its weight."""
    joints = KINEMATICS.inverse(feet)
    return replace(
        standing_state(ROBOT), time_ns=step * STEP_NS, step=step, joint_position=joints,
        joint_torque=bearing(joints, shares),
    )  # fmt: skip


@pytest.mark.parametrize("hanging", [(0,), (3,), (0, 3), (1, 2)])
def test_hanging_feet_go_straight_down_as_fast_as_said_and_others_stay(
    hanging: tuple[int, ...],
) -> None:
    nominal, shares = KINEMATICS.position(ROBOT.stand_pose), np.full(4, 0.3)
    shares[list(hanging)] = 0.0
    states = [standing(step, nominal, shares) for step in range(11)]
    footing = Footing(ROBOT, states[0])
    targets = [footing.step(state) for state in states]
    moved = KINEMATICS.position(targets[-1]) - KINEMATICS.position(targets[0])
    down = np.zeros((4, 3))
    down[list(hanging), 2] = -LOWERING_MPS * 0.1
    np.testing.assert_allclose(moved, down, atol=1e-6)
    assert not footing.is_over(states[-1])
    assert footing.is_over(standing(LONGEST_NS // STEP_NS, nominal, shares))


@pytest.mark.parametrize("away", [(0.05, 0.0), (-0.05, 0.02), (0.0, -0.04)])
def test_the_base_is_led_over_feet_that_do_not_move_and_then_it_is_over(
    away: tuple[float, float],
) -> None:
    nominal, shares = KINEMATICS.position(ROBOT.stand_pose), np.full(4, 0.25)
    feet = nominal + np.array([*away, 0.0])
    footing = Footing(ROBOT, standing(0, feet, shares))
    for step in range(LONGEST_NS // STEP_NS):
        last, state = feet, standing(step, feet, shares)
        stiff = footing.gains[0][0]
        feet = KINEMATICS.position(footing.step(state) - state.joint_torque / stiff)
        apart = (feet - last) - (feet - last).mean(axis=0)
        np.testing.assert_allclose(apart, 0.0, atol=1e-3)
        if footing.is_over(state):
            break
    assert BEARS_NS // STEP_NS <= step < LONGEST_NS // STEP_NS - 1
    assert np.linalg.norm((feet - nominal)[:, :2].mean(axis=0)) < 0.02


def test_where_torques_are_not_known_no_foot_goes_down() -> None:
    nominal = KINEMATICS.position(ROBOT.stand_pose)
    states = [standing(step, nominal, np.zeros(4)) for step in range(50)]
    footing = Footing(ROBOT, states[0])
    for state in states:
        np.testing.assert_allclose(footing.step(state), ROBOT.stand_pose, atol=1e-9)
