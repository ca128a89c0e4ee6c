"""Reading a heightmap between and around its points; numpy and torch."""

from saltus.arrays import Array, Constant, namespace
from saltus.grid import HEIGHTMAP_X

_SPACING = float(HEIGHTMAP_X[1] - HEIGHTMAP_X[0])
_LAST = len(HEIGHTMAP_X) - 1
_GRID = Constant(HEIGHTMAP_X)


def height_at(heights: Array, x: Array) -> Array:
    """Heights at any distance ahead of the base, by linear interpolation; the outermost heights go on for ever.

    Args:
        heights: On the grid [m], shape (..., 30).
        x: [m], shape (..., k), with the same leading dimensions.

    Returns:
        [m], shape (..., k).
    """
    xp = namespace(heights)
    position = xp.clip((x - float(HEIGHTMAP_X[0])) * (1.0 / _SPACING), 0.0, float(_LAST))
    left = xp.clip(xp.astype(position, xp.int64), 0, _LAST - 1)
    weight = position - xp.astype(left, position.dtype)
    low = xp.take_along_axis(heights, left, axis=-1)
    high = xp.take_along_axis(heights, left + 1, axis=-1)
    return low + weight * (high - low)


def highest_between(heights: Array, start: Array, end: Array) -> Array:
    """Highest terrain between two distances, ends included. Shapes (..., 30), (...), (...) -> (...)."""
    xp = namespace(heights)
    low, high = xp.minimum(start, end)[..., None], xp.maximum(start, end)[..., None]
    grid = _GRID.like(heights)
    ends = height_at(heights, xp.concat([low, high], axis=-1))
    # Points outside of the interval are replaced by its start, which is no higher than the result.
    inside = xp.where((low <= grid) & (high >= grid), heights, ends[..., :1])
    return xp.maximum(xp.max(ends, axis=-1), xp.max(inside, axis=-1))


def slope(heights: Array, start: float, end: float) -> Array:
    """Slope of the line that fits the heights between two distances best. Shape (..., 30) -> (...)."""
    inside = (start <= HEIGHTMAP_X) & (end >= HEIGHTMAP_X)
    centred = inside * (HEIGHTMAP_X - HEIGHTMAP_X[inside].mean())
    return heights @ Constant(centred / (centred @ centred)).like(heights)
