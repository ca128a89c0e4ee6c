"""Cuts the time of one robot into runs, from each start to the next."""

import numpy as np
from numpy.typing import NDArray

from saltus.heightmap.settings import MIN_TICKS


def runs(starts: NDArray[np.bool_]) -> list[slice]:
    """Spans of at least `MIN_TICKS` from one start to the next;
    `starts` says which ticks are one, shape (ticks,).
    """
    first = np.flatnonzero(starts)
    last = np.append(first[1:], len(starts))
    return [slice(int(a), int(b)) for a, b in zip(first, last, strict=True) if b - a >= MIN_TICKS]
