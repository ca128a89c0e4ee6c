import mujoco
import numpy as np
import pytest
import torch

from saltus import rotations
from saltus.config import TerrainConfig
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.robots.robot import LEGS, Robot
from saltus.robots.shipped import shipped_robots
from saltus.sim import robot_model
from saltus.terrain.curriculum import make_terrain

RNG = np.random.default_rng(0)
ANGLES = RNG.uniform([-np.pi, -1.5, -np.pi], [np.pi, 1.5, np.pi], (200, 3))


@pytest.fixture(scope="module", params=shipped_robots())
def robot(request) -> Robot:
    return load_robot(request.param)


@pytest.fixture(scope="module")
def kinematics(robot) -> LegKinematics:
    return LegKinematics(robot)


@pytest.fixture(scope="module")
def anywhere(robot) -> np.ndarray:
    return RNG.uniform(robot.joint_lower, robot.joint_upper, (200, 12))


@pytest.fixture(scope="module")
def reachable(robot) -> np.ndarray:
    """Feet below the hips and knees bent: where the inverse has one answer."""
    bent = RNG.uniform(np.tile([-0.8, 0.2, -2.6], 4), np.tile([0.8, 1.3, -0.95], 4), (200, 12))
    return np.concatenate([robot.stand_pose[None], bent])


@pytest.fixture(scope="module")
def model(robot):
    return robot_model.build_spec(robot, make_terrain(TerrainConfig(terrain="flat"))).compile()


def test_inverse_undoes_forward_kinematics(kinematics, reachable):
    back = kinematics.inverse(kinematics.position(reachable))
    np.testing.assert_allclose(back, reachable, atol=1e-9)


def test_unreachable_targets_give_finite_angles_that_point_at_them(robot, kinematics):
    anchor = robot.hip_anchor + np.array([0.0, 1.0, 0.0]) * robot.abduction_offset[:, None]
    far = anchor + np.array([0.3, 0.0, -0.6])
    feet = kinematics.position(kinematics.inverse(far))
    np.testing.assert_allclose((feet - anchor)[:, 0] / (feet - anchor)[:, 2], -0.5, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(feet - anchor, axis=-1), robot.leg_length, atol=1e-9)
    assert np.isfinite(kinematics.inverse(robot.hip_anchor + 0.01)).all()


def test_jacobian_equals_finite_differences(kinematics, anywhere):
    step = 1e-6
    jacobian = kinematics.jacobian(anywhere)
    for joint in range(12):
        delta = np.zeros(12)
        delta[joint] = step
        slope = (kinematics.position(anywhere + delta) - kinematics.position(anywhere - delta)) / (
            2 * step
        )
        np.testing.assert_allclose(
            jacobian[:, joint // 3, :, joint % 3], slope[:, joint // 3], atol=1e-8
        )
        others = [leg for leg in range(4) if leg != joint // 3]
        np.testing.assert_allclose(slope[:, others], 0.0, atol=1e-12)


def test_feet_and_jacobians_equal_those_of_mujoco(model, kinematics, anywhere):
    data = mujoco.MjData(model)
    geoms = [model.geom(f"{leg}_foot").id for leg in LEGS]
    for joints, angles in zip(anywhere, ANGLES, strict=True):
        quaternion = rotations.quaternion_from_roll_pitch_yaw(
            *(np.asarray(angle) for angle in angles)
        )
        data.qpos[:] = np.concatenate([[0.3, -0.2, 1.0], quaternion, joints])
        mujoco.mj_forward(model, data)
        rotation = rotations.rotation_matrix(quaternion)
        position, jacobian = kinematics.position_and_jacobian(joints)
        np.testing.assert_allclose(
            position @ rotation.T + data.qpos[:3], data.geom_xpos[geoms], atol=1e-9
        )
        for leg, geom in enumerate(geoms):
            theirs = np.zeros((3, model.nv))
            mujoco.mj_jac(model, data, theirs, None, data.geom_xpos[geom], model.geom_bodyid[geom])
            ours = rotation @ jacobian[leg]
            np.testing.assert_allclose(ours, theirs[:, 6 + 3 * leg : 9 + 3 * leg], atol=1e-6)


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_torch_equals_numpy_for_any_batch(robot, kinematics, batch):
    joints = RNG.uniform(-1.0, 1.0, (*batch, 12)) + robot.stand_pose
    for function in (kinematics.position, kinematics.jacobian):
        np.testing.assert_allclose(
            function(torch.as_tensor(joints)).numpy(), function(joints), atol=1e-12
        )
    feet = kinematics.position(joints)
    back = kinematics.inverse(torch.as_tensor(feet)).numpy()
    np.testing.assert_allclose(back, kinematics.inverse(feet), atol=1e-12)


def test_single_precision_stays_single(kinematics):
    position, jacobian = kinematics.position_and_jacobian(torch.zeros((2, 12), dtype=torch.float32))
    assert position.dtype == jacobian.dtype == torch.float32
