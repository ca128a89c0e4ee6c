"""The shipped robot says what the house was built on, to the bit."""

from pathlib import Path

import numpy as np
import pytest
import torch

import saltus.robots
from saltus import go1, kinematics
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import derive_robot, load_robot
from saltus.robots.similarity import Similarity

ROBOT = load_robot("go1")
FOLDER = Path(saltus.robots.__file__).parent / "go1"
RNG = np.random.default_rng(0)
NUMBERS = {
    "hip_anchor": go1.HIP_ANCHOR,
    "side": go1.SIDE,
    "abduction_offset": go1.SIDE * go1.ABDUCTION_LENGTH,
    "thigh_length": go1.THIGH_LENGTH,
    "calf_length": go1.CALF_LENGTH,
    "foot_radius": go1.FOOT_RADIUS,
    "trunk_size": go1.TRUNK_SIZE,
    "trunk_center": np.zeros(3),
    "trunk_mass": go1.TRUNK_MASS,
    "link_mass": np.tile([go1.HIP_MASS, go1.THIGH_MASS, go1.CALF_MASS], 4),
    "mass": go1.MASS,
    "armature": go1.ARMATURE,
    "reduction": go1.REDUCTION,
    "joint_lower": go1.JOINT_LOWER,
    "joint_upper": go1.JOINT_UPPER,
    "torque_limit": go1.TORQUE_LIMIT,
    "speed_limit": go1.SPEED_LIMIT,
    "stand_pose": go1.STAND_POSE,
    "stand_height": go1.STAND_HEIGHT,
    "swing_foot_z": go1.SWING_FOOT_Z,
    "camera_position": go1.CAMERA_POSITION,
    "camera_pitch": go1.CAMERA_PITCH,
}


@pytest.mark.parametrize("name", NUMBERS)
def test_its_numbers_are_the_old_ones(name):
    np.testing.assert_array_equal(getattr(ROBOT, name), NUMBERS[name])


def test_feet_are_where_they_were():
    legs = LegKinematics(ROBOT)
    joints, feet = RNG.uniform(-3.0, 3.0, (500, 12)), RNG.uniform(-0.5, 0.5, (500, 4, 3))
    np.testing.assert_array_equal(legs.position(joints), kinematics.foot_position(joints))
    np.testing.assert_array_equal(legs.jacobian(joints), kinematics.foot_jacobian(joints))
    np.testing.assert_array_equal(legs.inverse(feet), kinematics.inverse_kinematics(feet))
    assert legs.positions_of_one(joints[0].tolist()) == kinematics.foot_positions_of_one(joints[0].tolist())
    on_torch = torch.as_tensor(joints, dtype=torch.float32)
    assert torch.equal(legs.position(on_torch), kinematics.foot_position(on_torch))


def test_guesses_for_a_robot_of_its_size_are_its_own_numbers():
    size = Similarity.of(ROBOT.leg_length, ROBOT.mass)
    np.testing.assert_allclose(_derived_inertia(), ROBOT.inertia, rtol=0.01)
    for name in ("swing_foot_z", "landing_reach", "foot_force"):
        np.testing.assert_allclose(getattr(size, name), getattr(ROBOT, name), rtol=1e-6)
    assert vars(size.gains) == pytest.approx(vars(ROBOT.gains), rel=1e-6)
    position = size.camera_position(float(ROBOT.hip_anchor[0, 0]))
    np.testing.assert_allclose(position, ROBOT.camera_position, atol=0.008)


def _derived_inertia() -> np.ndarray:
    return derive_robot(str(FOLDER / "go1.xml")).robot.inertia
