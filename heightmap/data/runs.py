"""Cuts the time of one robot into runs, from each start to the next."""

import numpy as np
from numpy.typing import NDArray

from saltus.heightmap.settings import MIN_TICKS


def runs(starts: NDArray[np.bool_]) -> list[slice]:
    """Spans from one start to the next, of at least `MIN_TICKS`.

    Args:
        starts: Whether the robot starts anew with a tick, shape (ticks,).
    """
    first = np.flatnonzero(starts)
    last = np.append(first[1:], len(starts))
    return [slice(int(a), int(b)) for a, b in zip(first, last, strict=True) if b - a >= MIN_TICKS]
