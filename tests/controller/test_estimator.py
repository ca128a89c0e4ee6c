import numpy as np
import pytest
import torch
from samples import KINEMATICS, ROBOT

from saltus.constants import PHYSICS_DT
from saltus.controller.estimator import Estimator, EstimatorState
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix
from saltus.states import SensorArrays

DT = PHYSICS_DT
VELOCITY = np.array([0.4, -0.1, 0.0])
HEIGHT = 0.25


def walking(ticks, robots, feet_slip=0.0):
    """Bodies that glide level at `VELOCITY` while their feet stand, in exact measurements."""
    rng = np.random.default_rng(9)
    joints = ROBOT.stand_pose + rng.uniform(-0.1, 0.1, (robots, 12))
    yaw = rng.uniform(-3.0, 3.0, robots)
    quaternion = quaternion_from_roll_pitch_yaw(0.0 * yaw, 0.0 * yaw, yaw)
    rotation = rotation_matrix(quaternion)
    foot, jacobian = KINEMATICS.position_and_jacobian(joints)
    # What a foot at rest does in the base frame
    foot_velocity = -((VELOCITY + feet_slip) @ rotation)
    velocity = np.linalg.solve(
        jacobian, np.broadcast_to(foot_velocity[:, None, :, None], (robots, 4, 3, 1))
    )
    measured = SensorArrays(
        quaternion_base_in_world=quaternion,
        angular_velocity_base=np.zeros((robots, 3)),
        acceleration_base=np.broadcast_to([0.0, 0.0, 9.81], (robots, 3)),
        joint_position=joints,
        joint_velocity=velocity.reshape(robots, 12),
    )
    height = ROBOT.foot_radius - foot[..., 2]
    return [measured] * ticks, height


def test_converges_to_velocity_and_height():
    measurements, height = walking(400, 20)
    estimator, trusted = Estimator(ROBOT), np.tile([True, True, False, False], (20, 1))
    state = estimator.init((20,), measurements[0].joint_position)
    for measured in measurements:
        state = estimator.step(measured, trusted, state)
    np.testing.assert_allclose(
        state.velocity_base_in_world, np.broadcast_to(VELOCITY, (20, 3)), atol=0.01
    )
    np.testing.assert_allclose(state.base_height, height[:, :2].mean(axis=-1), atol=0.002)


def test_falls_freely_without_trusted_legs():
    measurements, _ = walking(1, 1)
    flying = SensorArrays(**{**vars(measurements[0]), "acceleration_base": np.zeros((1, 3))})
    estimator = Estimator(ROBOT)
    state = estimator.init((1,), flying.joint_position)
    for _ in range(100):
        state = estimator.step(flying, np.zeros((1, 4), dtype=bool), state)
    np.testing.assert_allclose(state.velocity_base_in_world, [[0.0, 0.0, -9.81 * 0.2]], atol=1e-9)
    np.testing.assert_allclose(
        state.base_height, [ROBOT.stand_height - 9.81 * 0.2**2 / 2], atol=0.003
    )


def test_a_foot_that_flies_is_hardly_believed_but_no_error_lasts():
    measurements, _ = walking(1, 1)
    slipping, _ = walking(1, 1, feet_slip=2.0)
    estimator, trusted = Estimator(ROBOT), np.ones((1, 4), dtype=bool)
    state = estimator.init((1,), measurements[0].joint_position)
    for _ in range(400):
        state = estimator.step(measurements[0], trusted, state)
    for _ in range(25):
        state = estimator.step(slipping[0], trusted, state)
    assert np.linalg.norm(state.velocity_base_in_world - VELOCITY) < 0.15
    for _ in range(1500):
        state = estimator.step(slipping[0], trusted, state)
    assert np.linalg.norm(state.velocity_base_in_world - VELOCITY - 2.0) < 0.05


def test_numpy_equals_torch_and_state_is_kept():
    measurements, _ = walking(1, 5)
    tensors = SensorArrays(
        **{k: torch.as_tensor(np.array(v)) for k, v in vars(measurements[0]).items()}
    )
    trusted = np.random.default_rng(10).random((5, 4)) < 0.5
    estimator = Estimator(ROBOT)
    ours = estimator.init((5,), measurements[0].joint_position)
    theirs = estimator.init((5,), tensors.joint_position)
    before = ours.mean.copy()
    for _ in range(20):
        theirs = estimator.step(tensors, torch.as_tensor(trusted), theirs)
        ours = estimator.step(measurements[0], trusted, ours)
    np.testing.assert_allclose(theirs.mean.numpy(), ours.mean, atol=1e-12)
    start = estimator.init((5,), measurements[0].joint_position)
    estimator.step(measurements[0], trusted, start)
    np.testing.assert_array_equal(start.mean, before)
    assert isinstance(ours, EstimatorState)


@pytest.mark.parametrize("trusted", [[True] * 4, [False] * 4])
def test_variance_stays_positive_and_bounded_when_legs_are_trusted(trusted):
    measurements, _ = walking(1, 1)
    estimator = Estimator(ROBOT)
    state = estimator.init((1,), measurements[0].joint_position)
    for _ in range(2000):
        state = estimator.step(measurements[0], np.array([trusted]), state)
    assert (state.variance > 0.0).all()
    assert (state.variance < (0.01 if trusted[0] else 1.0)).all()
