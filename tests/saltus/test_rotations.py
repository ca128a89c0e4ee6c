import numpy as np

from saltus import rotations

RNG = np.random.default_rng(0)
ANGLES = RNG.uniform([-np.pi, -1.5, -np.pi], [np.pi, 1.5, np.pi], (200, 3))


def test_angles_survive_quaternion_and_matrix():
    roll, pitch, yaw = ANGLES.T
    quaternion = rotations.quaternion_from_roll_pitch_yaw(roll, pitch, yaw)
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=-1), 1.0)
    rotation = rotations.rotation_matrix(quaternion)
    np.testing.assert_allclose(
        rotation @ rotation.mT, np.broadcast_to(np.eye(3), rotation.shape), atol=1e-12
    )
    np.testing.assert_allclose(np.stack(rotations.roll_pitch_yaw(rotation), -1), ANGLES, atol=1e-9)
    level = rotations.quaternion_from_roll_pitch_yaw(0.0 * yaw, 0.0 * yaw, yaw)
    np.testing.assert_allclose(
        rotations.yaw_rotation(yaw), rotations.rotation_matrix(level), atol=1e-12
    )


def test_skew_is_the_cross_product():
    v, u = RNG.normal(size=(2, 50, 3))
    np.testing.assert_allclose(
        (rotations.skew(v) @ u[..., None])[..., 0], np.cross(v, u), atol=1e-12
    )


def test_floats_of_one_robot_give_the_same_rotation():
    for angles in ANGLES:
        quaternion = rotations.quaternion_from_roll_pitch_yaw(
            *(np.asarray(angle) for angle in angles)
        )
        rotation = rotations.rotation_of_one(quaternion.tolist())
        np.testing.assert_allclose(
            rotation, rotations.rotation_matrix(quaternion), rtol=0.0, atol=1e-15
        )
