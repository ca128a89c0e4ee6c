"""Random numbers and images that depend on nothing but a key and a counter or an instant,
and windows over images.

All of it is whole-array arithmetic on the array API: numpy and torch, batched or one by one, give
the same numbers.
"""

import math
from collections.abc import Callable, Hashable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Array, Namespace, namespace

# Constants of a 32-bit integer hash of low bias (hash-prospector, "lowbias32" family). Both are
# below 2^31, so that their product with 32 bits fits an int64, the widest integer that numpy and
# torch share.
_SHIFTS = (16, 15, 15)
_MIXES = (0x21F0AAAD, 0x735A2D97)
_MASK = 0xFFFFFFFF


def draw_keys(batch: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.int64]:
    """One key of 32 bits for each robot, shape `batch`."""
    return np.asarray(rng.integers(0, 2**32, size=batch, dtype=np.int64))


def uniform_numbers(keys: Array, time_s: Array) -> Array:
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
    value = (value * _MIXES[0]) & _MASK
    value = value ^ (value >> _SHIFTS[1])
    value = (value * _MIXES[1]) & _MASK
    return value ^ (value >> _SHIFTS[2])


# Two rounds of a 32-bit hash of low bias (as in saltus.effects.random_fields) on int32, whose
# products wrap. Shifts keep the sign, which halves the number of different values, not the quality
# of their upper bits, and saves masking.
_FACTORS = (0x21F0AAAD, 0x735A2D97)
_GOLDEN = 0x9E3779B1  # 2^32 over the golden ratio: spreads consecutive counters over all bits
# Uniform numbers, for a sum that is normal to 0.3 % of its standard deviation up to three of them
ENOUGH_TO_ADD = 9


def white(keys: Array, time_s: Array, shape: tuple[int, int]) -> Array:
    """Independent random int32, shape (..., *shape); upper bits are better than lower ones.

    Args:
        keys: one per image, from `saltus.effects.random_fields.draw_keys`, shape (...).
        time_s: the instant [s], shape (...).
        shape: height and width.
    """
    # Of all namespaces that of floats alone has no hash, and times of images are arrays
    counters = _counters(namespace(time_s), shape, time_s.device)  # type: ignore[arg-type]
    return _hashed(counters ^ _seeds(keys, time_s)[..., None, None])


def unit_uniform(keys: Array, time_s: Array, shape: tuple[int, int], dtype: object) -> Array:
    """Independent uniform numbers in (0, 1) of the given type, shape (..., *shape)."""
    return _unit(white(keys, time_s, shape), dtype)


def _seeds(keys: Array, time_s: Array) -> Array:
    xp = namespace(time_s)
    return xp.astype(uniform_numbers(keys, time_s) * 2.0**32 - 2.0**31, xp.int32)


def _hashed(value: Array) -> Array:
    """Mixes int32 in place."""
    value ^= value >> 16
    value *= _FACTORS[0]
    value ^= value >> 15
    value *= _FACTORS[1]
    return value


def _unit(value: Array, dtype: object) -> Array:
    result = namespace(value).astype(value >> 16, dtype)
    result += 2.0**15 + 0.5
    result *= 2.0**-16
    return result


def gaussian_field(
    keys: Array, time_s: Array, shape: tuple[int, int], window: tuple[int, int], dtype: object
) -> Array:
    """Normal numbers of mean 0 and variance 1 whose correlation falls linearly to 0 over `window`:
    a moving average.

    A sum of nine uniform numbers or more is as good as normal, so that no normal numbers are drawn;
    a window that has fewer than nine samples adds up three for each.

    Args:
        keys: one per image, shape (...).
        time_s: the instant [s], shape (...).
        shape: height and width.
        window: height and width of the window [samples].
        dtype: of the result.

    Returns:
        Shape (..., *shape).
    """
    rows, columns = window
    values = white(keys, time_s, (shape[0] + rows - 1, shape[1] + columns - 1))
    if rows * columns >= ENOUGH_TO_ADD:
        parts, bits = 1, 16
        values >>= 16
    else:
        parts, bits = 3, 10
        values = (values >> 22) + ((values << 10) >> 22) + ((values << 20) >> 22)
    total = windowed_sum(windowed_sum(values, rows, -2), columns, -1)
    count, levels = rows * columns * parts, 1 << bits
    result = namespace(total).astype(total, dtype)
    result += 0.5 * count  # the numbers lie between -levels / 2 and levels / 2 - 1
    result *= 1.0 / math.sqrt(count * (levels**2 - 1) / 12.0)
    return result


def windowed_sum(values: Array, size: int, axis: int) -> Array:
    """Sums over every window of `size` along an axis, which becomes `size - 1` shorter."""
    length = values.shape[axis] - size + 1
    total, taken, run, block = None, 0, values, 1
    while True:
        if size & block:
            part = _cut(run, taken, length, axis)
            total = part if total is None else total + part
            taken += block
        if 2 * block > size:
            return total
        reach = run.shape[axis] - block
        run = _cut(run, 0, reach, axis) + _cut(run, block, reach, axis)
        block *= 2


def windowed_extreme(
    values: Array, size: int, axis: int, pick: Callable[[Array, Array], Array]
) -> Array:
    """Maximum or minimum (`pick`) over every window of `size` along an axis,
    which becomes `size - 1` shorter.
    """
    run, block = values, 1
    while 2 * block <= size:
        reach = run.shape[axis] - block
        run = pick(_cut(run, 0, reach, axis), _cut(run, block, reach, axis))
        block *= 2
    length = values.shape[axis] - size + 1
    return (
        pick(_cut(run, 0, length, axis), _cut(run, size - block, length, axis))
        if size > block
        else run
    )


def extreme_around(
    values: Array, rows: int, columns: int, pick: Callable[[Array, Array], Array]
) -> Array:
    """Extreme within `rows` and `columns` of each sample.

    What lies beyond the border counts as the border does.
    """
    for reach, axis in ((rows, -2), (columns, -1)):
        if reach:
            values = windowed_extreme(padded(values, reach, axis), 2 * reach + 1, axis, pick)
    return values


def mean_around(values: Array, rows: int, columns: int) -> Array:
    """Mean within `rows` and `columns` of each sample; borders as in `extreme_around`."""
    total = windowed_sum(padded(values, rows, -2), 2 * rows + 1, -2)
    total = windowed_sum(padded(total, columns, -1), 2 * columns + 1, -1)
    return total * (1.0 / ((2 * rows + 1) * (2 * columns + 1)))


def padded(values: Array, count: int, axis: int) -> Array:
    """Repeats the first and the last row or column `count` times."""
    xp = namespace(values)
    last = values.shape[axis] - 1
    first_part = [_cut(values, 0, 1, axis)] * count
    last_part = [_cut(values, last, 1, axis)] * count
    return xp.concat([*first_part, values, *last_part], axis=axis)


def samples_across(length_px: float, pitch: float) -> int:
    """How many samples come nearest to a length on the sensor; one at least."""
    return max(1, round(length_px / pitch))


def _cut(values: Array, start: int, length: int, axis: int) -> Array:
    part = slice(start, start + length)
    return values[..., part, :] if axis == -2 else values[..., part]


@lru_cache(maxsize=64)
def _counters(xp: Namespace, shape: tuple[int, int], device: Hashable) -> Array:
    """A different int32 for every sample, shape `shape`."""
    count = np.arange(shape[0] * shape[1], dtype=np.uint32) * np.uint32(_GOLDEN)
    return xp.asarray(count.view(np.int32).reshape(shape), device=device)
