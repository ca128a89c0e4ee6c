"""Poses in which a robot rests: it stands on the slope that its feet give, or lies."""

import numpy as np

from saltus.arrays import Array, Constant, Floats, Joints, Legs, Scalars, namespace
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot

LYING_CLEARANCE_M = 0.03
"""Ground clearance of a trunk that lies: a trunk that touches the ground ends a trial. The folded
legs of a Go1 reach no less."""

STEEPEST = 0.8
"""Slope that a robot stands on: stairs of 0.20 m."""
TILT = 0.75
"""Share of the slope by which the base over feet that do not move is tilted: legs of a level one
would have to differ in length by the height of two stairs."""
REACH = 0.85
"""Greatest height of the base above such a foot, by the length of the legs."""


class RestingPoses:
    """Joint angles of a robot that rests, by its feet relative to the base, in the yaw frame [m].

    Feet have the shape (..., 4, 3).
    """

    def __init__(self, robot: Robot) -> None:
        self._legs = LegKinematics(robot)
        self._stand_feet = Constant(self._legs.position(robot.stand_pose))
        self._lying = Constant(lying_pose(robot))
        self._reach = REACH * (robot.thigh_length + robot.calf_length)
        self._lower, self._upper = Constant(robot.joint_lower), Constant(robot.joint_upper)

    def lying(self, feet: Legs) -> Joints:
        """Joint angles with folded legs [rad], shape (..., 12), whatever its feet do."""
        zero = namespace(feet).zeros_like(feet[..., 0, :1])
        return self._lying.like(feet) + zero

    def over_feet(self, feet: Legs) -> Joints:
        """Joint angles to stand over the feet where they are [rad], shape (..., 12).

        The base comes over their middle, tilted by `TILT` of the slope that they give to each
        side. No foot moves over the ground: on stairs one that does catches on an edge, and the
        robot tips over.
        """
        xp, stand = namespace(feet), self._stand_feet.like(feet)
        feet = feet + (xp.mean(stand, axis=-2) - xp.mean(feet, axis=-2))[..., None, :]
        pitch = TILT * xp.atan(self._slope(feet))
        left, right = (xp.mean(feet[..., side, :], axis=-2) for side in ([1, 3], [0, 2]))
        apart = xp.clip(left[..., 1] - right[..., 1], 0.5 * float(stand[1, 1] - stand[0, 1]), None)
        roll = TILT * xp.atan((left[..., 2] - right[..., 2]) / apart)[..., None]
        x, y, z = self._turned_back(feet, pitch)
        cosine, sine = xp.cos(roll), xp.sin(roll)
        y, z = cosine * y + sine * z, cosine * z - sine * y
        too_low = xp.clip(-self._reach - xp.min(z, axis=-1), 0.0, None)[..., None]
        return self._angles(xp.stack([x, y, z + too_low], axis=-1))

    def standing(self, feet: Legs) -> Joints:
        """Joint angles to stand on the slope that the feet give, shape (..., 12).

        The base is over the middle of the feet and pitched by half the slope: a trunk that is
        parallel to stairs of 0.20 m has its weight behind the rear feet, and for a level one the
        rear legs are too short.
        """
        xp, slope = namespace(feet), self._slope(feet)
        stand = self._stand_feet.like(feet) + 0.0 * slope[..., None, None]
        x, y, z = stand[..., 0], stand[..., 1], stand[..., 2]
        sloping = xp.stack([x, y, z + slope[..., None] * x], axis=-1)
        return self._angles(xp.stack(self._turned_back(sloping, 0.5 * xp.atan(slope)), axis=-1))

    def _slope(self, feet: Legs) -> Scalars:
        """Slope of the ground between the front and the rear feet, shape (...)."""
        xp = namespace(feet)
        pairs = xp.mean(xp.reshape(feet, (*feet.shape[:-2], 2, 2, 3)), axis=-2)
        ahead = pairs[..., 0, :] - pairs[..., 1, :]
        stand = self._stand_feet.like(feet)
        apart = float(stand[0, 0] - stand[2, 0])
        slope = ahead[..., 2] / xp.clip(ahead[..., 0], 0.5 * apart, None)
        return xp.clip(slope, -STEEPEST, STEEPEST)

    def _turned_back(self, feet: Legs, pitch: Scalars) -> tuple[Array, Array, Array]:
        """Coordinates of feet in the yaw frame in a base that is pitched up [m], (..., 4) each."""
        xp = namespace(feet)
        cosine, sine = xp.cos(pitch)[..., None], xp.sin(pitch)[..., None]
        x, y, z = feet[..., 0], feet[..., 1], feet[..., 2]
        return cosine * x + sine * z, y, cosine * z - sine * x

    def _angles(self, feet: Legs) -> Joints:
        angles = self._legs.inverse(feet)
        xp = namespace(angles)
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
