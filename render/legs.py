"""The robot's legs as a camera on its trunk sees them: capsules for thighs and calves, balls for feet.

Trunk and hips are left out: a camera in front of the trunk that looks ahead has them behind its image plane or, at
less than 2 cm in front of it, outside of any field of view below 150 degrees.
"""

from dataclasses import dataclass

import numpy as np

from saltus.go1 import ABDUCTION_LENGTH, FOOT_RADIUS, HIP_ANCHOR, SIDE, THIGH_LENGTH
from saltus.kinematics import foot_position
from saltus.messages import Floats

THIGH_RADIUS = 0.020  # unitree_ros: the collision box is 0.0245 by 0.034 m
CALF_RADIUS = 0.015  # unitree_ros: the collision box is 0.016 m wide; the visual shell nearly twice that


@dataclass(frozen=True, kw_only=True, eq=False)
class Capsules:
    """Points within `radius` of a segment; a ball where its ends coincide."""

    start: Floats
    """[m], shape (..., 12, 3)."""
    end: Floats
    """[m], shape (..., 12, 3)."""
    radius: Floats
    """[m], shape (12,)."""


RADIUS = np.repeat([THIGH_RADIUS, CALF_RADIUS, FOOT_RADIUS], 4)


def leg_capsules(joint_position: Floats) -> Capsules:
    """Four thighs, four calves and four feet in the base frame, each in the order of `saltus.go1.LEGS`.

    Args:
        joint_position: [rad], shape (..., 12).
    """
    q = np.asarray(joint_position, dtype=np.float64)
    angles = q.reshape((*q.shape[:-1], 4, 3))
    sine, cosine = np.sin(angles[..., 0]), np.cos(angles[..., 0])
    offset = SIDE * ABDUCTION_LENGTH
    thigh_joint = HIP_ANCHOR + _abducted(np.zeros_like(sine), offset, np.zeros_like(sine), sine, cosine)
    along = -THIGH_LENGTH * np.sin(angles[..., 1])
    drop = -THIGH_LENGTH * np.cos(angles[..., 1])
    knee = HIP_ANCHOR + _abducted(along, offset, drop, sine, cosine)
    foot = foot_position(q)
    start = np.concatenate([thigh_joint, knee, foot], axis=-2)
    end = np.concatenate([knee, foot, foot], axis=-2)
    return Capsules(start=start, end=end, radius=RADIUS)


def _abducted(x: Floats, y: Floats, z: Floats, sine: Floats, cosine: Floats) -> Floats:
    """Turns points about the x axis, shapes (..., 4) -> (..., 4, 3)."""
    return np.stack([x, y * cosine - z * sine, y * sine + z * cosine], axis=-1)
