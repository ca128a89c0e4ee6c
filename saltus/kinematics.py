"""Leg kinematics, for numpy and torch and any leading batch dimensions, in part for one robot's floats.

The leg: abduction about x at the hip anchor, a lateral offset to the leg's side, then thigh and calf about y; all
angles are zero with the leg straight down, positive angles swing the foot backwards. Source: unitree_ros.
"""

import math
from collections.abc import Sequence

import numpy as np

from saltus import go1
from saltus.arrays import Array, Constant, namespace

_ANCHOR = Constant(go1.HIP_ANCHOR)
_ABDUCTION = Constant(go1.SIDE * go1.ABDUCTION_LENGTH)
_ANCHORS: list[list[float]] = go1.HIP_ANCHOR.tolist()
_OFFSETS: list[float] = (go1.SIDE * go1.ABDUCTION_LENGTH).tolist()
_CHAIN_ANGLES = Constant([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]])  # abduction, thigh, thigh + calf
_L2 = go1.THIGH_LENGTH
_L3 = go1.CALF_LENGTH
# A foot cannot be nearer to the abduction axis than the abduction link: closer targets are projected out to this [m].
_MINIMUM_EXTENSION = 0.01


def foot_kinematics(joint_position: Array) -> tuple[Array, Array]:
    """Centres of the foot spheres in the base frame [m] and their Jacobians [m/rad].

    Args:
        joint_position: [rad], shape (..., 12).

    Returns:
        Positions, shape (..., 4, 3), and Jacobians, shape (..., 4, 3, 3): `jacobian @ joint_velocity` is the velocity
        of the foot in the base frame.
    """
    sine, cosine, x, y, z, drop, calf_x, calf_z = _leg(joint_position)
    xp = namespace(joint_position)
    s1, c1 = sine[..., 0], cosine[..., 0]
    position = xp.stack([x, y, z], -1) + _ANCHOR.like(joint_position)
    entries = [xp.zeros_like(x), drop, calf_z, -z, x * s1, calf_x * s1, y, -x * c1, -calf_x * c1]
    return position, xp.stack(entries, -1).reshape((*x.shape, 3, 3))


def foot_position(joint_position: Array) -> Array:
    """Centres of the foot spheres in the base frame [m]. Shape (..., 12) -> (..., 4, 3)."""
    _, _, x, y, z, *_ = _leg(joint_position)
    return namespace(joint_position).stack([x, y, z], -1) + _ANCHOR.like(joint_position)


def foot_positions_of_one(joint_position: Sequence[float]) -> list[tuple[float, float, float]]:
    """`foot_position` of one robot in floats: the four feet as (x, y, z), without the cost of small arrays."""
    feet = []
    for leg, (anchor_x, anchor_y, anchor_z) in enumerate(_ANCHORS):
        abduction, thigh, calf = joint_position[3 * leg : 3 * leg + 3]
        shin = thigh + calf
        sines = math.sin(abduction), math.sin(thigh), math.sin(shin)
        x, y, z, *_ = _foot(sines, (math.cos(abduction), math.cos(thigh), math.cos(shin)), _OFFSETS[leg])
        feet.append((x + anchor_x, y + anchor_y, z + anchor_z))
    return feet


def _leg(joint_position: Array) -> tuple[Array, ...]:
    """What positions and Jacobians share.

    Sines and cosines of the chain's angles, (..., 4, 3); the foot's x, y, z from the anchor, its drop in the leg's own
    plane, and the calf's share of x and of the drop, each (..., 4).
    """
    xp = namespace(joint_position)
    angles = joint_position.reshape((*joint_position.shape[:-1], 4, 3)) @ _CHAIN_ANGLES.like(joint_position).mT
    sine, cosine = xp.sin(angles), xp.cos(angles)
    sines = sine[..., 0], sine[..., 1], sine[..., 2]
    cosines = cosine[..., 0], cosine[..., 1], cosine[..., 2]
    return sine, cosine, *_foot(sines, cosines, _ABDUCTION.like(joint_position))


def _foot(sines: Sequence[Array], cosines: Sequence[Array], offset: Array) -> tuple[Array, ...]:
    """The law of a leg, for arrays and floats: x, y, z, drop and the calf's share as in `_leg`.

    Args:
        sines: Of abduction, thigh, thigh + calf.
        cosines: The same.
        offset: Abduction link to the left [m].
    """
    s1, s2, s3 = sines
    c1, c2, c3 = cosines
    calf_x, calf_z = -_L3 * s3, -_L3 * c3
    x = calf_x - _L2 * s2
    drop = calf_z - _L2 * c2  # along the leg's own plane, before abduction
    return x, offset * c1 - drop * s1, offset * s1 + drop * c1, drop, calf_x, calf_z


def foot_jacobian(joint_position: Array) -> Array:
    """Foot velocity in the base frame by joint velocity. Shape (..., 12) -> (..., 4, 3, 3)."""
    return foot_kinematics(joint_position)[1]


def inverse_kinematics(foot_position_base: Array) -> Array:
    """Joint angles, knees bent backwards, that put the feet at the given points.

    A point out of reach gives the straight leg towards it; a point nearer to the abduction axis than the abduction
    link gives the angles of the nearest point that can be reached.

    Args:
        foot_position_base: [m], shape (..., 4, 3).

    Returns:
        [rad], shape (..., 12); joint limits are not applied.
    """
    xp = namespace(foot_position_base)
    local = foot_position_base - _ANCHOR.like(foot_position_base)
    x, y, z = local[..., 0], local[..., 1], local[..., 2]
    offset = _ABDUCTION.like(foot_position_base)
    drop = xp.sqrt(xp.clip(y * y + z * z - go1.ABDUCTION_LENGTH**2, _MINIMUM_EXTENSION**2, None))
    abduction = xp.atan2(z, y) - xp.atan2(-drop, offset)
    abduction = abduction - 2.0 * np.pi * xp.round(abduction * (0.5 / np.pi))  # into [-pi, pi]
    cosine = (x * x + drop * drop - (_L2 * _L2 + _L3 * _L3)) * (0.5 / (_L2 * _L3))
    calf = -xp.acos(xp.clip(cosine, -1.0, 1.0))
    thigh = xp.atan2(-x, drop) - xp.atan2(_L3 * xp.sin(calf), _L2 + _L3 * xp.cos(calf))
    return xp.stack([abduction, thigh, calf], -1).reshape((*foot_position_base.shape[:-2], 12))
