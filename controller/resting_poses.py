"""Poses in which a robot rests: it stands on the slope that its feet give, or lies."""

import numpy as np

from saltus.arrays import Constant, Floats, Joints, namespace
from saltus.controller.signals import YawFrameBody
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.wire.messages import ControllerMode

LYING_CLEARANCE_M = 0.03
"""Ground clearance of a trunk that lies: a trunk that touches the ground ends a trial. The folded
legs of a Go1 reach no less."""


class RestingPoses:
    """Joint angles of the modes in which a robot rests."""

    def __init__(self, robot: Robot, steepest: float) -> None:
        """Takes the steepest slope that the robot stands on."""
        self._steepest = steepest
        self._legs = LegKinematics(robot)
        self._stand_feet = Constant(self._legs.position(robot.stand_pose))
        self._lying = Constant(lying_pose(robot))
        self._lower, self._upper = Constant(robot.joint_lower), Constant(robot.joint_upper)

    def of(self, mode: ControllerMode, body: YawFrameBody) -> Joints:
        """Joint angles of a mode in which the robot rests [rad], shape (..., 12)."""
        if mode != ControllerMode.LIE:
            return self._standing(body)
        zero = namespace(body.roll).zeros_like(body.roll)
        return self._lying.like(body.roll) + zero[..., None]

    def _standing(self, body: YawFrameBody) -> Joints:
        """Joint angles to stand on the slope that the feet give, shape (..., 12).

        The base is over the middle of the feet and pitched by half the slope: a trunk that is
        parallel to stairs of 0.20 m has its weight behind the rear feet, and for a level one the
        rear legs are too short.
        """
        xp = namespace(body.roll)
        pairs = xp.mean(xp.reshape(body.foot_yaw, (*body.foot_yaw.shape[:-2], 2, 2, 3)), axis=-2)
        ahead = pairs[..., 0, :] - pairs[..., 1, :]
        stand = self._stand_feet.like(body.roll)
        apart = float(stand[0, 0] - stand[2, 0])
        slope = xp.clip(
            ahead[..., 2] / xp.clip(ahead[..., 0], 0.5 * apart, None),
            -self._steepest,
            self._steepest,
        )[..., None]
        pitch = 0.5 * xp.atan(slope)
        cosine, sine = xp.cos(pitch), xp.sin(pitch)
        x, y, z = (
            stand[..., 0] + 0.0 * slope,
            stand[..., 1] + 0.0 * slope,
            stand[..., 2] + slope * stand[..., 0],
        )
        angles = self._legs.inverse(
            xp.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=-1)
        )
        return xp.clip(angles, self._lower.like(angles), self._upper.like(angles))


def lying_pose(robot: Robot) -> Floats:
    """Joint angles with the feet below the thighs' axes and the trunk just above the ground [rad].

    Shape (12,), within the range of the joints.
    """
    foot = robot.hip_anchor.copy()
    foot[:, 1] += robot.abduction_offset
    foot[:, 2] = robot.foot_radius - LYING_CLEARANCE_M
    foot[:, 2] += robot.trunk_center[2] - 0.5 * robot.trunk_size[2]
    angles = LegKinematics(robot).inverse(foot)
    return np.asarray(np.clip(angles, robot.joint_lower, robot.joint_upper))
