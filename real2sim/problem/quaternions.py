"""Quaternions (w, x, y, z) of unit length, in arrays of shape (..., 4)."""

import numpy as np

from saltus.arrays import Floats


def normalise_quaternions(quaternion: Floats) -> Floats:
    """Scales quaternions (..., 4) to length 1; NaN of one that is 0."""
    return np.asarray(quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True))


def to_vector(quaternion: Floats) -> Floats:
    """Rotation vector [rad] of the shorter way, shape (..., 3)."""
    quaternion = np.where(quaternion[..., :1] < 0.0, -quaternion, quaternion)
    sine = np.linalg.norm(quaternion[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, quaternion[..., :1])
    return np.asarray(quaternion[..., 1:] * angle / np.where(sine > 1e-12, sine, 1.0))


def turn_slightly(quaternion: Floats, vector: Floats) -> Floats:
    """Rotations followed by a small one in the turned frame, to first order:
    shapes (..., 4) and (..., 3) [rad].
    """
    w, v, half = quaternion[..., :1], quaternion[..., 1:], 0.5 * vector
    scalar = w - np.sum(v * half, axis=-1, keepdims=True)
    return normalise_quaternions(
        np.concatenate([scalar, v + w * half + np.cross(v, half)], axis=-1)
    )


def continuous_quaternions(quaternion: Floats) -> Floats:
    """Rotations with signs that do not change from row to row, shape (n, 4)."""
    flips = np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0.0
    return np.asarray(
        quaternion * np.cumprod(np.concatenate([[1.0], np.where(flips, -1.0, 1.0)]))[:, None]
    )


def up_in_body(quaternion: Floats) -> Floats:
    """The world's vertical in the turned frame, shape (..., 3)."""
    w, x, y, z = (quaternion[..., i] for i in range(4))
    return np.stack(
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=-1
    )
