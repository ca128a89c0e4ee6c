"""Errors with which a robot follows commanded velocities."""

import math

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats


def tracking_errors(
    error: Floats, fresh: NDArray[np.bool_], *, stride: int, settling: int
) -> list[float]:
    """Mean absolute errors of velocities, averaged at each step over the last `stride` ones.

    Args:
        error: Velocity less its command, ahead, aside [m/s], turn [rad/s], shape (steps, n, 3).
        fresh: Where a robot began, or got another command, with that step, shape (steps, n).
        stride: Steps over which velocities are averaged: about a stride, within which trunks sway.
        settling: Steps after a start or another command that are left out.

    Returns:
        Ahead, aside, turn; NaN where no robot kept its command for settling + stride steps.
    """
    kept, since = [], np.zeros(fresh.shape[1], dtype=np.int64)
    for step in range(len(error)):
        since = np.where(fresh[step], 0, since + 1)
        long = since >= settling + stride
        kept.append(np.abs(error[max(0, step - stride + 1) : step + 1].mean(axis=0))[long])
    found = np.concatenate(kept)
    return found.mean(axis=0).tolist() if len(found) else [math.nan] * 3
