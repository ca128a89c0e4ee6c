"""Feet surely stand that bear weight and rest, for as long as it takes to be sure."""

from dataclasses import replace

import numpy as np
import pytest

from saltus.constants import GRAVITY, PHYSICS_DT
from saltus.controller.estimator import Estimator
from saltus.controller.standing_feet import LEAST_SHARE, STANDS_S, StandingFeet
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.robots.shipped import shipped_robots
from saltus.rotations import rotation_matrix
from saltus.states import SensorArrays

TICKS = round(STANDS_S / PHYSICS_DT)
ROBOTS = [load_robot(name) for name in shipped_robots()]


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
@pytest.mark.parametrize("seed", range(20))
def test_a_foot_stands_that_bears_weight_and_rests_and_no_other(robot, seed: int) -> None:
    """In any pose and motion of the base; each leg bears enough or not, and rests or not."""
    rng = np.random.default_rng(seed)
    legs, feet = LegKinematics(robot), StandingFeet(robot)
    quaternion = np.array([1.0, *rng.uniform(-0.2, 0.2, 3)])
    quaternion /= np.linalg.norm(quaternion)
    rotation = rotation_matrix(quaternion)
    position = robot.stand_pose + rng.uniform(-0.2, 0.2, 12)
    foot, jacobian = legs.position_and_jacobian(position)
    turning, velocity = rng.normal(0.0, 1.0, 3), rng.normal(0.0, 0.7, 3)
    bears, rests = rng.random(4) < 0.7, rng.random(4) < 0.7
    share = np.where(bears, rng.uniform(1.2, 4.0, 4), rng.uniform(-1.0, 0.8, 4)) * LEAST_SHARE
    force = share[:, None] * robot.mass * GRAVITY * rotation[2]  # up, in the base frame
    torque = -(jacobian.mT @ force[..., None])[..., 0].ravel()
    moves = np.where(rests[:, None], 0.0, [[0.6, 0.0, 0.0]])  # of the feet in the world
    still = (moves - velocity) @ rotation - np.cross(turning, foot)
    measured = SensorArrays(
        quaternion_base_in_world=quaternion,
        angular_velocity_base=turning,
        acceleration_base=np.zeros(3),
        joint_position=position,
        joint_velocity=np.linalg.solve(jacobian, still[..., None])[..., 0].ravel(),
    )
    for tick in range(TICKS + 3):
        stands = feet.step(measured, torque, velocity)
        np.testing.assert_array_equal(stands, bears & rests & (tick + 1 >= TICKS))
    assert not feet.step(measured, np.zeros(12), velocity).any()
    assert not feet.step(measured, torque, velocity).any()  # it has to be sure again


@pytest.mark.parametrize("wrong", [(2.0, 0.0, 0.0), (0.0, -1.0, 0.5), (0.4, 0.0, 0.0)])
def test_a_velocity_that_is_wrong_does_not_last(wrong: tuple[float, float, float]) -> None:
    """By it feet that stand seem to move, and no others tell of it."""
    for robot in ROBOTS:
        estimator, feet = Estimator(robot), StandingFeet(robot)
        estimate = estimator.init((), robot.stand_pose)
        estimate = replace(estimate, mean=estimate.mean + np.array([*wrong, 0.0]))
        _, jacobian = LegKinematics(robot).position_and_jacobian(robot.stand_pose)
        force = np.array([0.0, 0.0, 0.25 * robot.mass * GRAVITY])
        torque = -(jacobian.mT @ force[:, None])[..., 0].ravel()
        measured = SensorArrays(
            quaternion_base_in_world=np.array([1.0, 0.0, 0.0, 0.0]),
            angular_velocity_base=np.zeros(3),
            acceleration_base=np.array([0.0, 0.0, GRAVITY]),
            joint_position=robot.stand_pose,
            joint_velocity=np.zeros(12),
        )
        for _ in range(round(2.0 / PHYSICS_DT)):
            stands = feet.step(measured, torque, estimate.velocity_base_in_world)
            estimate = estimator.step(measured, stands, estimate)
        np.testing.assert_allclose(estimate.velocity_base_in_world, 0.0, atol=0.02)
        assert stands.all()
