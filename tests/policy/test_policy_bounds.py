"""How far the learned policy may go, against what legs and courses ask for."""

from dataclasses import replace

import numpy as np
import pytest
from samples import KINEMATICS, ROBOT

from saltus.controller.swing import SwingLegs
from saltus.controller.yaw_frame import YawFrameBody, observe_body
from saltus.policy.bounds import ACTIONS, ActionBounds, plan_from_values, values_of
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix
from saltus.states import standing_state

HIGHEST_STEP = 0.75  # [m], what the policy is to reach in the end
LIFT = ACTIONS.index("front_residual_z")


def body(pitch: float) -> YawFrameBody:
    """A robot with its legs in the standing pose."""
    flat, legs = np.zeros(1), ROBOT.stand_pose[None]
    level = quaternion_from_roll_pitch_yaw(flat, flat + pitch, flat)
    return observe_body(
        replace(standing_state(ROBOT), quaternion_base_in_world=level, joint_position=legs),
        KINEMATICS,
    )


def highest_sole(lift: float, base_height: float, pitch: float) -> float:
    """Height of a front sole over the ground of the feet in stance,
    after the joints have followed their target.
    """
    robot, swing, joints = body(pitch), SwingLegs(ROBOT), ROBOT.stand_pose[None]
    height = np.array([base_height])
    path = swing.nominal_path(robot, robot.foot_yaw, np.full((1, 4), 0.6), np.array([0.2]), height)
    for _ in range(12):  # a tick moves a joint's target by 0.5 rad at most
        joints = swing.joint_target(robot, path + np.array([0.05, 0.0, lift]), joints)
    rotation = rotation_matrix(
        quaternion_from_roll_pitch_yaw(np.zeros(1), np.array([pitch]), np.zeros(1))
    )
    foot = KINEMATICS.position(joints) @ rotation.mT
    return float(base_height + foot[0, 0, 2] - ROBOT.foot_radius)


def test_a_foot_can_be_brought_onto_the_highest_step() -> None:
    assert highest_sole(ActionBounds().high[LIFT], base_height=0.5, pitch=-0.9) > HIGHEST_STEP


@pytest.mark.parametrize("pitch", [-0.9, -0.6, -0.3])
@pytest.mark.parametrize("lift", [0.4, 0.5, 0.6])
def test_no_sole_within_reach_comes_higher_than_its_lift(lift: float, pitch: float) -> None:
    for base_height in (0.3, 0.4, 0.5, 0.6):
        assert highest_sole(lift, base_height, pitch) < lift - ROBOT.foot_radius + 0.005


def test_outputs_of_one_are_the_bounds() -> None:
    bounds = ActionBounds()
    for sign, limit in ((-1.0, bounds.low), (1.0, bounds.high)):
        np.testing.assert_allclose(
            bounds.denormalised(np.full(len(ACTIONS), sign)), limit, atol=1e-12
        )
        np.testing.assert_allclose(bounds.normalised(np.array(limit)), sign, atol=1e-12)


def test_values_and_actions_are_the_same_in_other_words() -> None:
    values = np.random.default_rng(0).normal(size=(3, 7, len(ACTIONS)))
    np.testing.assert_array_equal(values_of(plan_from_values(values)), values)
