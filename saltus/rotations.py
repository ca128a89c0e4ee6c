"""Rotations, for numpy and torch and any leading batch dimensions, in part for one robot's floats.

Vectors are rows: `points_base @ rotation.mT` turns (..., n, 3) points by a base-to-world rotation
(..., 3, 3).
"""

from collections.abc import Sequence

import numpy as np

from saltus.arrays import Constant, Quaternions, Rotations, Scalars, Vectors, namespace

_LEVI_CIVITA = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _LEVI_CIVITA[_i, _j, _k], _LEVI_CIVITA[_i, _k, _j] = 1.0, -1.0
SKEW = np.transpose(_LEVI_CIVITA, (2, 0, 1)).reshape(3, 9) * -1.0
"""`(v @ SKEW).reshape(3, 3) @ u` is v x u. Shape (3, 9)."""
_SKEW = Constant(SKEW)


def rotation_matrix(quaternion: Quaternions) -> Rotations:
    """Rotation matrix of a unit quaternion (w, x, y, z). Shape (..., 4) -> (..., 3, 3)."""
    if (
        isinstance(quaternion, np.ndarray) and quaternion.ndim == 1
    ):  # a fifth of the time of small arrays
        return np.array(rotation_of_one(quaternion.tolist()), dtype=quaternion.dtype)
    rows = rotation_of_one([quaternion[..., i] for i in range(4)])
    entries = [entry for row in rows for entry in row]
    return namespace(quaternion).stack(entries, -1).reshape((*quaternion.shape[:-1], 3, 3))


def rotation_of_one(quaternion: Sequence[Scalars]) -> tuple[tuple[Scalars, Scalars, Scalars], ...]:
    """`rotation_matrix` row by row, from the four components as floats or arrays."""
    w, x, y, z = quaternion
    ww, xx, yy, zz = w * w, x * x, y * y, z * z
    xy, xz, yz = 2.0 * (x * y), 2.0 * (x * z), 2.0 * (y * z)
    wx, wy, wz = 2.0 * (w * x), 2.0 * (w * y), 2.0 * (w * z)
    return (
        (ww + xx - yy - zz, xy - wz, xz + wy),
        (xy + wz, ww - xx + yy - zz, yz - wx),
        (xz - wy, yz + wx, ww - xx - yy + zz),
    )


def roll_pitch_yaw(rotation: Rotations) -> tuple[Scalars, Scalars, Scalars]:
    """Angles [rad] of R = Rz(yaw) Ry(pitch) Rx(roll); each of shape (...)."""
    up = (rotation[..., 2, 0], rotation[..., 2, 1], rotation[..., 2, 2])
    return angles_of_axes((rotation[..., 0, 0], rotation[..., 1, 0]), up)


def angles_of_axes(
    forward: tuple[Scalars, Scalars], up: tuple[Scalars, Scalars, Scalars]
) -> tuple[Scalars, Scalars, Scalars]:
    """Roll, pitch and yaw [rad] by the components of R on which they depend, arrays or floats.

    `forward` is x and y in the world of the base's x axis, `up` x, y, z in the base of the world's
    z axis.
    """
    xp = namespace(up[0])
    pitch = xp.asin(xp.clip(-up[0], -1.0, 1.0))
    return xp.atan2(up[1], up[2]), pitch, xp.atan2(forward[1], forward[0])


def quaternion_from_roll_pitch_yaw(roll: Scalars, pitch: Scalars, yaw: Scalars) -> Quaternions:
    """Unit quaternion (w, x, y, z) of Rz(yaw) Ry(pitch) Rx(roll). Shapes (...) -> (..., 4)."""
    xp = namespace(roll)
    cr, sr = xp.cos(0.5 * roll), xp.sin(0.5 * roll)
    cp, sp = xp.cos(0.5 * pitch), xp.sin(0.5 * pitch)
    cy, sy = xp.cos(0.5 * yaw), xp.sin(0.5 * yaw)
    return xp.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        -1,
    )


def quaternion_from_vector(vector: Vectors) -> Quaternions:
    """Quaternion (w, x, y, z) of a rotation vector [rad],
    for numpy alone; shapes (..., 4) of (..., 3).
    """
    angle = (vector**2).sum(-1, keepdims=True) ** 0.5
    return np.concatenate(
        [np.cos(0.5 * angle), 0.5 * np.sinc(0.5 * angle / np.pi) * vector], axis=-1
    )


def quaternion_product(one: Quaternions, other: Quaternions) -> Quaternions:
    """Hamilton product of quaternions (w, x, y, z): first `other`, then `one`. Shapes (..., 4)."""
    xp = namespace(one)
    aw, ax, ay, az = (one[..., i] for i in range(4))
    bw, bx, by, bz = (other[..., i] for i in range(4))
    return xp.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )


def quaternion_inverse(quaternion: Quaternions) -> Quaternions:
    """The inverse rotation of a unit quaternion (w, x, y, z). Shape (..., 4)."""
    w, x, y, z = (quaternion[..., i] for i in range(4))
    return namespace(quaternion).stack([w, -x, -y, -z], -1)


def yaw_rotation(yaw: Scalars) -> Rotations:
    """Rotation from the yaw frame to the world. Shape (...) -> (..., 3, 3)."""
    xp = namespace(yaw)
    c, s = xp.cos(yaw), xp.sin(yaw)
    zero, one = xp.zeros_like(c), xp.ones_like(c)
    return xp.stack([c, -s, zero, s, c, zero, zero, zero, one], -1).reshape((*yaw.shape, 3, 3))


def skew(vector: Vectors) -> Rotations:
    """Matrix of the cross product, `skew(v) @ u` = v x u. Shape (..., 3) -> (..., 3, 3)."""
    return (vector @ _SKEW.like(vector)).reshape((*vector.shape[:-1], 3, 3))
