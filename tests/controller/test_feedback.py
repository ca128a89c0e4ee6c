from dataclasses import replace

import numpy as np
from samples import KINEMATICS, ROBOT

from saltus.controller.velocity_feedback import SpeedBrake, VelocityFeedback
from saltus.controller.yaw_frame import observe_body
from saltus.joint_command import JointCommand

FEEDBACK = VelocityFeedback(ROBOT)


def test_feet_of_a_body_at_its_reference_stand_still_in_the_world(draw):
    plan, sensed = draw(np.random.default_rng(7), (300,))
    body = observe_body(sensed, KINEMATICS)
    # Below the drives' speed limits
    velocity, angular = (
        0.3 * plan.velocity,
        0.3 * plan.angular_velocity,
    )
    joint = FEEDBACK.joint_velocity(body, velocity, angular).reshape(300, 4, 3)
    relative = (body.jacobian @ joint[..., None])[..., 0] @ body.base_in_yaw.mT
    in_world = velocity[:, None] + np.cross(angular[:, None], body.foot_yaw) + relative
    kept = (np.abs(joint) < ROBOT.speed_limit.reshape(4, 3)).all(axis=-1)
    assert kept.mean() > 0.9
    assert np.percentile(np.linalg.norm(in_world[kept], axis=-1), 99) < 0.05


def test_straight_legs_do_not_blow_up(draw):
    _, sensed = draw(np.random.default_rng(8), ())
    straight = KINEMATICS.inverse(
        ROBOT.hip_anchor + np.array([0.0, 0.0, -1.0]) + 0.08 * ROBOT.side[:, None] * [0, 1, 0]
    )
    body = observe_body(type(sensed)(**{**vars(sensed), "joint_position": straight}), KINEMATICS)
    joint = FEEDBACK.joint_velocity(body, np.array([3.0, 0.0, 3.0]), np.array([0.0, 6.0, 0.0]))
    assert (np.abs(joint) <= ROBOT.speed_limit).all()


def test_a_brake_pulls_back_what_nears_its_rated_speed_and_touches_nothing_else():
    rng, count = np.random.default_rng(3), 2000
    kd, rated, free = 8.0, ROBOT.speed_limit, SpeedBrake.FREE * ROBOT.speed_limit
    brake = SpeedBrake(replace(ROBOT, gains=replace(ROBOT.gains, brake_kd=kd)))
    speed = rng.uniform(-1.5, 1.5, (count, 12)) * rated
    command = JointCommand(
        position=rng.normal(size=(count, 12)), torque=rng.normal(size=(count, 12)),
        velocity=rng.uniform(-1.0, 1.0, (count, 12)) * rated,
        kp=rng.uniform(0.0, 30.0, (count, 12)), kd=rng.choice([0.0, 1.2], (count, 12)),
    )  # fmt: skip
    braked = brake(command, speed)
    for name in ("position", "torque", "kp"):
        np.testing.assert_array_equal(getattr(braked, name), getattr(command, name))
    added = braked.kd * (braked.velocity - speed) - command.kd * (command.velocity - speed)
    assert np.abs(added[np.abs(speed) < free]).max() < 1e-9
    beyond = np.abs(speed) > free
    assert (added * speed < 0.0)[beyond].all()
    over = np.abs(speed) > rated
    expected = -kd * np.sign(speed) * (np.abs(speed) - free)
    np.testing.assert_allclose(added[over], expected[over])
    assert (np.abs(added) <= np.abs(expected) + 1e-9)[beyond].all()
    assert SpeedBrake(ROBOT)(command, speed) is command
