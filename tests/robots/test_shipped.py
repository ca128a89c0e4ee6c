"""The shipped robot is what its sources say, to the bit."""

from pathlib import Path

import numpy as np
import pytest

import saltus.robots
from saltus.robots.loading import derive_robot, load_robot
from saltus.robots.similarity import Similarity

ROBOT = load_robot("go1")
FOLDER = Path(saltus.robots.__file__).parent / "go1"
NUMBERS = {
    # Geometry, masses [kg], limits: Unitree's robot description, rotors lumped into the links that carry them
    "hip_anchor": [[0.1881, -0.04675, 0.0], [0.1881, 0.04675, 0.0], [-0.1881, -0.04675, 0.0], [-0.1881, 0.04675, 0.0]],
    "side": [-1.0, 1.0, -1.0, 1.0],
    "abduction_offset": [-0.08, 0.08, -0.08, 0.08],
    "thigh_length": 0.213,
    "calf_length": 0.213,
    "foot_radius": 0.02,
    "trunk_size": [0.3762, 0.0935, 0.114],
    "trunk_center": [0.0, 0.0, 0.0],
    "trunk_mass": 5.204,
    "link_mass": 4 * [0.591 + 0.089, 0.92 + 0.089, 0.135862 + 0.06],
    "mass": 5.204 + 4 * (0.591 + 0.089 + (0.92 + 0.089) + (0.135862 + 0.06)),
    "armature": 1.118e-4 * np.tile([6.33, 6.33, 9.495], 4) ** 2,  # of the rotors, through the reduction
    "reduction": 4 * [6.33, 6.33, 9.495],
    "joint_lower": 4 * [-0.863, -0.686, -2.818],
    "joint_upper": 4 * [0.863, 4.501, -0.888],
    "torque_limit": 4 * [23.7, 23.7, 35.55],
    "speed_limit": 4 * [30.1, 30.1, 20.06],
    # The controller settings of the authors of "Agile Continuous Jumping in Discontinuous Terrains"
    "stand_pose": 4 * [0.0, 0.9, -1.8],
    "stand_height": 0.268,
    "swing_foot_z": [-0.4, 0.1],
    "camera_position": [0.272, 0.0075, 0.092],
    "camera_pitch": 0.52,
}


@pytest.mark.parametrize("name", NUMBERS)
def test_its_numbers_are_those_of_its_sources(name):
    np.testing.assert_array_equal(getattr(ROBOT, name), NUMBERS[name])


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
