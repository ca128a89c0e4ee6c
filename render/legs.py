"""The robot's legs as a camera on its trunk sees them: capsules for thighs and calves, balls for feet.

Trunk and hips are left out: a camera in front of the trunk that looks ahead has them behind its image plane or, at
less than 2 cm in front of it, outside of any field of view below 150 degrees.
"""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Array, Constant, namespace
from saltus.go1 import ABDUCTION_LENGTH, FOOT_RADIUS, HIP_ANCHOR, SIDE, THIGH_LENGTH
from saltus.kinematics import foot_position
from saltus.wire.messages import Floats

THIGH_RADIUS = 0.020  # unitree_ros: the collision box is 0.0245 by 0.034 m
CALF_RADIUS = 0.015  # unitree_ros: the collision box is 0.016 m wide; the visual shell nearly twice that


@dataclass(frozen=True, kw_only=True, eq=False)
class Capsules:
    """Points within `radius` of a segment; a ball where its ends coincide."""

    start: Array
    """[m], shape (..., 12, 3)."""
    end: Array
    """[m], shape (..., 12, 3)."""
    radius: Floats
    """[m], shape (12,)."""


RADIUS = np.repeat([THIGH_RADIUS, CALF_RADIUS, FOOT_RADIUS], 4)


_ANCHOR = Constant(HIP_ANCHOR)
_OFFSET = Constant(SIDE * ABDUCTION_LENGTH)


def leg_capsules(joint_position: Array) -> Capsules:
    """Four thighs, four calves and four feet in the base frame, each in the order of `saltus.robots.robot.LEGS`.

    Args:
        joint_position: [rad], numpy or torch, shape (..., 12).
    """
    xp = namespace(joint_position)
    angles = joint_position.reshape((*joint_position.shape[:-1], 4, 3))
    sine, cosine = xp.sin(angles[..., 0]), xp.cos(angles[..., 0])
    anchor, offset = _ANCHOR.like(joint_position), _OFFSET.like(joint_position)
    along = -THIGH_LENGTH * xp.sin(angles[..., 1])
    drop = -THIGH_LENGTH * xp.cos(angles[..., 1])
    # the leg's own plane, turned about x by the abduction
    thigh_joint = anchor + xp.stack([xp.zeros_like(sine), offset * cosine, offset * sine], -1)
    knee = anchor + xp.stack([along, offset * cosine - drop * sine, offset * sine + drop * cosine], -1)
    foot = foot_position(joint_position)
    return Capsules(
        start=xp.concat([thigh_joint, knee, foot], axis=-2), end=xp.concat([knee, foot, foot], axis=-2), radius=RADIUS
    )
