"""Reading heights between and around the points of a line ahead; numpy and torch."""

import numpy as np

from saltus.arrays import Array, Constant, namespace
from saltus.errors import ConfigError
from saltus.grid import HeightGrid

_EVEN_M = 1e-9  # rounding of points that were spread evenly


class HeightLine:
    """Reads heights on a grid that is one line of even spacing; n points.

    Raises:
        ConfigError: another grid.
    """

    def __init__(self, grid: HeightGrid) -> None:
        x = np.array(grid.x)
        steps = np.diff(x)
        if len(grid.y) != 1 or len(x) < 2 or np.ptp(steps) > _EVEN_M:
            raise ConfigError(
                "rules read heights on one line of even spacing: give another grid, or train a "
                "policy"
            )
        self._x, self._first, self._last = x, float(x[0]), len(x) - 1
        self._spacing, self._points = float(x[1] - x[0]), Constant(x)

    def height_at(self, heights: Array, x: Array) -> Array:
        """Heights at any distance ahead of the base, by linear interpolation.

        The outermost heights go on for ever.

        Args:
            heights: On the grid [m], shape (..., n).
            x: [m], shape (..., k), with the same leading dimensions.

        Returns:
            [m], shape (..., k).
        """
        xp, last = namespace(heights), self._last
        position = xp.clip((x - self._first) * (1.0 / self._spacing), 0.0, float(last))
        left = xp.clip(xp.astype(position, xp.int64), 0, last - 1)
        weight = position - xp.astype(left, position.dtype)
        low = xp.take_along_axis(heights, left, axis=-1)
        high = xp.take_along_axis(heights, left + 1, axis=-1)
        return low + weight * (high - low)

    def highest_between(self, heights: Array, start: Array, end: Array) -> Array:
        """Highest terrain between two distances, ends included.

        Shapes (..., n), (...), (...) -> (...).
        """
        xp = namespace(heights)
        low, high = xp.minimum(start, end)[..., None], xp.maximum(start, end)[..., None]
        points = self._points.like(heights)
        ends = self.height_at(heights, xp.concat([low, high], axis=-1))
        # Points outside of the interval are replaced by its start, which is no higher than the
        # result.
        inside = xp.where((low <= points) & (high >= points), heights, ends[..., :1])
        return xp.maximum(xp.max(ends, axis=-1), xp.max(inside, axis=-1))

    def slope(self, heights: Array, start: float, end: float) -> Array:
        """Slope of the line that fits the heights between two distances best.

        Shape (..., n) -> (...).
        """
        inside = (start <= self._x) & (end >= self._x)
        centred = inside * (self._x - self._x[inside].mean())
        return heights @ Constant(centred / (centred @ centred)).like(heights)
