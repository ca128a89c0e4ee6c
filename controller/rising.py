"""A robot that lies, or stands in any other way, is led to its stand pose."""

import numpy as np

from saltus.arrays import Floats
from saltus.joint_command import JointCommand
from saltus.robots.robot import Robot

RISE_S = 2.0
"""A robot that lies gets up in this; one that stands already feels nothing of it."""
SOFT = 0.3
"""Share of the stand's stiffness with which it begins to rise."""


def rising_command(start: Floats, robot: Robot, time_s: float) -> JointCommand:
    """The command at a time of the rise, from joint angles `start`,
    shape (12,) [rad]: it never leaps.
    """
    share = time_s / RISE_S
    led = 0.5 * (1.0 - np.cos(np.pi * share))
    one, gains = np.ones(12), robot.gains
    stiff = (SOFT + (1.0 - SOFT) * share) * gains.stand_kp
    return JointCommand(
        position=start + led * (robot.stand_pose - start),
        velocity=0.0 * one, torque=0.0 * one, kp=stiff * one, kd=gains.stand_kd * one,
    )  # fmt: skip
