"""Reading a heightmap between and around its points."""

import numpy as np

from saltus.grid import HEIGHTMAP_X
from saltus.messages import Floats

_SPACING = float(HEIGHTMAP_X[1] - HEIGHTMAP_X[0])


def height_at(heights: Floats, x: Floats) -> Floats:
    """Heights at any distance ahead of the base, by linear interpolation; the outermost heights go on for ever.

    Args:
        heights: On the grid [m], shape (..., 30).
        x: [m], shape (..., k), with the same leading dimensions.

    Returns:
        [m], shape (..., k).
    """
    position = np.clip((x - HEIGHTMAP_X[0]) / _SPACING, 0.0, len(HEIGHTMAP_X) - 1.0)
    left = np.minimum(position.astype(np.intp), len(HEIGHTMAP_X) - 2)
    weight = position - left
    low = np.take_along_axis(heights, left, axis=-1)
    high = np.take_along_axis(heights, left + 1, axis=-1)
    return low + weight * (high - low)


def highest_between(heights: Floats, start: Floats, end: Floats) -> Floats:
    """Highest terrain between two distances, ends included. Shapes (..., 30), (...), (...) -> (...)."""
    low, high = np.minimum(start, end)[..., None], np.maximum(start, end)[..., None]
    inside = (low <= HEIGHTMAP_X) & (high >= HEIGHTMAP_X)
    ends = height_at(heights, np.concatenate([low, high], axis=-1)).max(axis=-1)
    return np.maximum(ends, np.where(inside, heights, -np.inf).max(axis=-1))


def slope(heights: Floats, start: float, end: float) -> Floats:
    """Slope of the line that fits the heights between two distances best. Shape (..., 30) -> (...)."""
    inside = (start <= HEIGHTMAP_X) & (end >= HEIGHTMAP_X)
    centred = np.where(inside, HEIGHTMAP_X - HEIGHTMAP_X[inside].mean(), 0.0)
    return heights @ (centred / (centred @ centred))
