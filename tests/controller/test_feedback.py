import numpy as np
from samples import KINEMATICS, ROBOT

from saltus.controller.feedback import FeedbackConfig, VelocityFeedback
from saltus.controller.signals import observe

FEEDBACK = VelocityFeedback(ROBOT, FeedbackConfig())


def test_feet_of_a_body_at_its_reference_stand_still_in_the_world(draw):
    plan, sensed = draw(np.random.default_rng(7), (300,))
    body = observe(sensed, KINEMATICS)
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
    body = observe(type(sensed)(**{**vars(sensed), "joint_position": straight}), KINEMATICS)
    joint = FEEDBACK.joint_velocity(body, np.array([3.0, 0.0, 3.0]), np.array([0.0, 6.0, 0.0]))
    assert (np.abs(joint) <= ROBOT.speed_limit).all()
