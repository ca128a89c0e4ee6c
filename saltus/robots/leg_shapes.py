"""A robot's legs as a camera on its trunk sees them:
capsules for thighs and calves, balls for feet.

Trunk and hips are left out: a camera in front of the trunk that looks ahead has them behind its
image plane or, at less than 2 cm in front of it, outside of any field of view below 150 degrees.
"""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Array, Constant, Floats, Joints, namespace
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.robots.similarity import Similarity

# Of the reference robot's legs, by its maker's published model; other robots' are in proportion to
# their length.
THIGH_RADIUS = 0.020  # the collision box is 0.0245 by 0.034 m
CALF_RADIUS = 0.015  # the collision box is 0.016 m wide; the visual shell nearly twice that


@dataclass(frozen=True, kw_only=True, eq=False)
class Capsules:
    """Points within `radius` of a segment; a ball where its ends coincide."""

    start: Array
    """[m], shape (..., 12, 3)."""
    end: Array
    """[m], shape (..., 12, 3)."""
    radius: Floats
    """[m], shape (12,)."""


class LegShapes:
    """Four thighs, four calves and four feet of a robot,
    each in the order of `saltus.robots.robot.LEGS`.
    """

    def __init__(self, robot: Robot) -> None:
        scale = Similarity.of_robot(robot).length
        self.radius: Floats = np.repeat(
            [scale * THIGH_RADIUS, scale * CALF_RADIUS, robot.foot_radius], 4
        )
        lengths = np.repeat([robot.thigh_length, robot.calf_length, 0.0], 4)
        self.sizes: list[tuple[float, float]] = list(
            zip(lengths.tolist(), self.radius.tolist(), strict=True)
        )
        """Length from start to end and radius of each [m]."""
        self._kinematics = LegKinematics(robot)
        self._thigh, self._zero = robot.thigh_length, robot.thigh_zero
        self._anchor, self._offset = Constant(robot.hip_anchor), Constant(robot.abduction_offset)

    def capsules(self, joint_position: Joints) -> Capsules:
        """Capsules of the legs, in the base frame.

        Args:
            joint_position: [rad], numpy or torch, shape (..., 12).
        """
        xp = namespace(joint_position)
        angles = joint_position.reshape((*joint_position.shape[:-1], 4, 3))
        sine, cosine, upper = (
            xp.sin(angles[..., 0]),
            xp.cos(angles[..., 0]),
            angles[..., 1] + self._zero,
        )
        anchor, offset = self._anchor.like(joint_position), self._offset.like(joint_position)
        along = -self._thigh * xp.sin(upper)
        drop = -self._thigh * xp.cos(upper)
        # the leg's own plane, turned about x by the abduction
        thigh = anchor + xp.stack([xp.zeros_like(sine), offset * cosine, offset * sine], -1)
        knee = anchor + xp.stack(
            [along, offset * cosine - drop * sine, offset * sine + drop * cosine], -1
        )
        foot = self._kinematics.position(joint_position)
        start, end = xp.concat([thigh, knee, foot], axis=-2), xp.concat([knee, foot, foot], axis=-2)
        return Capsules(start=start, end=end, radius=self.radius)
