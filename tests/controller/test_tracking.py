"""Joint targets: how they are held, and which feet are taken to stand."""

import numpy as np
import pytest
from samples import ROBOT

from saltus.controller.compensation import compensation_for
from saltus.controller.tracking import LEAST_SHARE, JointTargetTracking
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix
from saltus.states import SensorArrays
from saltus.wire.messages import JointPlan, PlanStatus


@pytest.mark.parametrize("name", ["go1", "go2"])
def test_feet_that_bear_weight_are_those_whose_torques_say_so(name):
    robot, rng = load_robot(name), np.random.default_rng(0)
    n = 500
    joints = robot.stand_pose + rng.uniform(-0.4, 0.4, (n, 12))
    angles = rng.uniform(-0.4, 0.4, (3, n))
    quaternion = quaternion_from_roll_pitch_yaw(*angles)
    weight = 9.81 * robot.mass
    force = rng.uniform([-0.1, -0.1, 0.0], [0.1, 0.1, 0.4], (n, 4, 3)) * weight  # world
    in_base = force @ rotation_matrix(quaternion)
    _, jacobian = LegKinematics(robot).position_and_jacobian(joints)
    torque = -(in_base[..., None, :] @ jacobian).reshape(n, 12)
    zero = np.zeros((n, 3))
    measured = SensorArrays(
        quaternion_base_in_world=quaternion,
        angular_velocity_base=zero,
        acceleration_base=zero,
        joint_position=joints,
        joint_velocity=np.zeros((n, 12)),
    )
    stands = JointTargetTracking(robot).contact(measured, torque)
    clear = np.abs(force[..., 2] - LEAST_SHARE * weight) > 1e-3 * weight
    np.testing.assert_array_equal(stands[clear], (force[..., 2] > LEAST_SHARE * weight)[clear])


def test_a_plan_is_held_with_its_own_gains_and_known_drives_are_made_up_for(tmp_path):
    rng = np.random.default_rng(1)
    target, kp, kd = rng.uniform(0.1, 1.0, (3, 12))
    plan = JointPlan(
        time_ns=0, step=0, status=PlanStatus.GO, joint_position=target, kp=kp, kd=kd, reason=""
    )
    command = JointTargetTracking(ROBOT).command(plan)
    for name, value in {"position": target, "kp": kp, "kd": kd, "velocity": 0, "torque": 0}.items():
        np.testing.assert_array_equal(getattr(command, name), np.broadcast_to(value, 12))
    known = tmp_path / "known.toml"
    known.write_text("[actuator]\ntorque_gain.gain = 0.8\n", encoding="utf-8")
    weaker = JointTargetTracking(ROBOT, compensation_for(str(known), ROBOT)).command(plan)
    np.testing.assert_allclose(weaker.kp, kp / 0.8)
    np.testing.assert_array_equal(weaker.position, target)
