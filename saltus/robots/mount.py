"""The pose of a camera on a robot's trunk.

Camera frame: x right in the image, y down in the image, z forward along the optical axis.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from saltus.arrays import Constant, Floats
from saltus.robots.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class Mount:
    """Where a camera sits on the trunk.

    The cameras of a batch of robots may each have a place of their own: then the poses that a mount
    is used with, and its numbers, share their leading dimension (n,).
    """

    position: Floats
    """Optical centre in the base frame [m], shape (3,) or (n, 3)."""
    pitch: float | Floats
    """Nose down positive [rad], one number or shape (n,)."""
    roll: float | Floats = 0.0
    """About the optical axis, right side down positive [rad], one number or shape (n,)."""
    yaw: float | Floats = 0.0
    """To the left positive [rad], one number or shape (n,).

    The base turns by yaw, then pitch, then roll.
    """

    @classmethod
    def of(cls, robot: Robot) -> "Mount":
        """Where a robot has its camera."""
        return cls(
            position=robot.camera_position,
            pitch=robot.camera_pitch,
            roll=robot.camera_roll,
            yaw=robot.camera_yaw,
        )

    @cached_property
    def rotation(self) -> Floats:
        """Camera frame to base frame, shape (3, 3) or (n, 3, 3)."""
        cr, cp, cy = (
            np.cos(angle) for angle in np.broadcast_arrays(self.roll, self.pitch, self.yaw)
        )
        sr, sp, sy = (
            np.sin(angle) for angle in np.broadcast_arrays(self.roll, self.pitch, self.yaw)
        )
        right = (sy * cr - cy * sp * sr, -cy * cr - sy * sp * sr, -cp * sr)
        down = (-cy * sp * cr - sy * sr, cy * sr - sy * sp * cr, -cp * cr)
        forward = (cy * cp, sy * cp, -sp)
        return np.stack([np.stack(axis, -1) for axis in (right, down, forward)], -1)

    @cached_property
    def in_base(self) -> tuple[Constant, Constant]:
        """Position and rotation for arrays of any library."""
        return Constant(self.position), Constant(self.rotation)
