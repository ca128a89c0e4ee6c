"""Random numbers that depend on nothing but a key and a counter,
equal for numpy and torch, batched or one by one.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Array, namespace

# Constants of a 32-bit integer hash of low bias (hash-prospector, "lowbias32" family). Both are
# below 2^31, so that their product with 32 bits fits an int64, the widest integer that numpy and
# torch share.
_SHIFTS = (16, 15, 15)
_FACTORS = (0x21F0AAAD, 0x735A2D97)
_MASK = 0xFFFFFFFF


def draw_keys(batch: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.int64]:
    """One key of 32 bits for each robot, shape `batch`."""
    return np.asarray(rng.integers(0, 2**32, size=batch, dtype=np.int64))


def uniform(keys: Array, time_s: Array) -> Array:
    """Uniform numbers in [0, 1), one per robot, that belong to an instant.

    Args:
        keys: from `draw_keys`, shape (...).
        time_s: the instant [s], float64, any finite value or infinite, shape (...); told apart to
            the microsecond.

    Returns:
        float64 (as `time_s`), shape (...).
    """
    if isinstance(time_s, np.generic | np.ndarray) and time_s.ndim == keys.ndim == 0:
        # Whole numbers of Python's own: a thirtieth of the time of arrays of one
        instant = round(float(time_s) * 1e6) & _MASK if np.isfinite(time_s) else 0
        return np.float64(_mixed(int(keys) ^ _mixed(instant)) / 2.0**32)
    xp = namespace(time_s)
    finite = xp.where(xp.isfinite(time_s), time_s, xp.zeros_like(time_s))
    counter = xp.astype(xp.round(finite * 1e6), xp.int64) & _MASK
    return xp.astype(_mixed(keys ^ _mixed(counter)), time_s.dtype) / 2.0**32


def _mixed(value: Any) -> Any:
    value = value ^ (value >> _SHIFTS[0])
    value = (value * _FACTORS[0]) & _MASK
    value = value ^ (value >> _SHIFTS[1])
    value = (value * _FACTORS[1]) & _MASK
    return value ^ (value >> _SHIFTS[2])
