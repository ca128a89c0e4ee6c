from dataclasses import replace

import numpy as np
import pytest
from samples import KINEMATICS, ROBOT

from saltus.controller.swing import BENT_FROM_MPS, SwingLegs
from saltus.controller.yaw_frame import observe_body

SWING = SwingLegs(ROBOT)
ROBOTS = 200


@pytest.fixture
def robots(draw):
    plan, sensed = draw(np.random.default_rng(5), (ROBOTS,))
    return plan, sensed, observe_body(sensed, KINEMATICS)


def path(body, sensed, progress, stance_s=0.2):
    duration = np.full(ROBOTS, stance_s)
    return SWING.nominal_path(
        body, body.foot_yaw, np.full((ROBOTS, 4), progress), duration, sensed.base_height
    )


def test_path_goes_from_liftoff_under_the_hip_to_a_landing_on_the_ground(robots):
    _, sensed, body = robots
    np.testing.assert_allclose(path(body, sensed, 0.0), body.foot_yaw)
    hip = np.array([[0.1881, -0.13, 0], [0.1881, 0.13, 0], [-0.1881, -0.13, 0], [-0.1881, 0.13, 0]])
    hip = hip @ body.base_in_yaw.mT
    middle, landing = path(body, sensed, 0.5), path(body, sensed, 1.0)
    np.testing.assert_allclose(middle[..., :2], hip[..., :2])
    for point in (middle, landing):
        np.testing.assert_allclose(
            point[..., 2], np.broadcast_to(-sensed.base_height[:, None], (ROBOTS, 4))
        )
    step = landing - middle
    assert (np.abs(step[..., :2]) <= np.array([0.15, 0.08]) + 1e-12).all()
    velocity = body.velocity[:, None] + np.cross(body.angular_velocity[:, None], hip)
    expected = np.clip(velocity[..., :2] * 0.1, [-0.15, -0.08], [0.15, 0.08])
    np.testing.assert_allclose(step[..., :2], expected, atol=1e-12)


def test_path_is_continuous_and_at_rest_at_its_three_points(robots):
    _, sensed, body = robots
    progress = np.linspace(0.0, 1.0, 201)
    points = np.array([path(body, sensed, p) for p in progress])
    jumps = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    extent = np.linalg.norm(points - points[0], axis=-1).max()
    assert jumps.max() < 4.0 * extent / 200
    for still in (0, 99, 100, 199):
        assert jumps[still].max() < 0.02 * jumps.max()


def test_targets_keep_every_clip(robots):
    plan, sensed, body = robots
    target = SWING.joint_target(
        body, path(body, sensed, 0.3) + plan.foot_residual, sensed.joint_position
    )
    assert (np.abs(target - sensed.joint_position) <= 0.5 + 1e-12).all()
    near = (sensed.joint_position > ROBOT.joint_lower) & (sensed.joint_position < ROBOT.joint_upper)
    assert (target[near] >= np.broadcast_to(ROBOT.joint_lower, target.shape)[near]).all()
    assert (target[near] <= np.broadcast_to(ROBOT.joint_upper, target.shape)[near]).all()


def test_reachable_targets_are_reached(robots):
    _, sensed, body = robots
    nearby = body.foot_yaw + np.random.default_rng(6).uniform(-0.01, 0.01, body.foot_yaw.shape)
    foot = (
        KINEMATICS.position(SWING.joint_target(body, nearby, sensed.joint_position))
        @ body.base_in_yaw.mT
    )
    wanted = nearby @ body.base_in_yaw
    inside = (wanted[..., 2] > -0.4) & (wanted[..., 2] < -0.1)
    joints = SWING.joint_target(body, nearby, sensed.joint_position).reshape(ROBOTS, 4, 3)
    limits = (joints > ROBOT.joint_lower.reshape(4, 3) + 2e-3) & (
        joints < ROBOT.joint_upper.reshape(4, 3) - 2e-3
    )
    kept = inside & limits.all(axis=-1)
    assert kept.mean() > 0.5
    np.testing.assert_allclose(foot[kept], nearby[kept], atol=1e-9)


def followed(swing, body, target, joint_position):
    """Targets of legs that have come as near to them as they can."""
    for _ in range(12):
        joint_position = swing.joint_target(body, target, joint_position)
    return joint_position


@pytest.mark.parametrize("bend", [1.0, 1.4])
def test_fast_robots_bend_their_knees_and_keep_the_direction_of_their_legs(robots, bend):
    plan, sensed, body = robots
    target = path(body, sensed, 0.9) + plan.foot_residual
    speed = np.random.default_rng(9).uniform(0.0, 1.5 * BENT_FROM_MPS, ROBOTS)
    heading = body.velocity * [1.0, 1.0, 0.0]
    heading = heading / np.linalg.norm(heading, axis=-1, keepdims=True)
    body = replace(body, velocity=speed[:, None] * heading)
    bent = SwingLegs(replace(ROBOT, gains=replace(ROBOT.gains, landing_bend=bend)))
    free, held = (
        followed(legs, body, target, sensed.joint_position).reshape(ROBOTS, 4, 3)
        for legs in (SWING, bent)
    )
    least = bend * np.minimum(speed / BENT_FROM_MPS, 1.0)[:, None]
    assert (held[..., 2] <= -least + 1e-9).all()
    straight = free[..., 2] > -least
    assert 0.1 < straight.mean() < 0.9
    np.testing.assert_array_equal(held[~straight], free[~straight])
    np.testing.assert_allclose(held[straight][:, 2], -np.broadcast_to(least, (ROBOTS, 4))[straight])
    np.testing.assert_array_equal(held[..., 0], free[..., 0])
    inside = straight & (held[..., 1] < ROBOT.joint_upper.reshape(4, 3)[:, 1] - 2e-3)
    assert inside.any()
    # thigh and calf of a Go1 are equally long: a leg's direction is that of half its bend
    lean = [joints[..., 1] + 0.5 * joints[..., 2] for joints in (free, held)]
    np.testing.assert_allclose(lean[1][inside], lean[0][inside])
