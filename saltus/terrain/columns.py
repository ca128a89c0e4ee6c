"""Courses whose boxes are columns side by side along x:
one search along x finds a height, whatever the y.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from saltus.arrays import Array, Floats, namespace
from saltus.terrain.boxes import Box


@dataclass(frozen=True, kw_only=True, eq=False)
class Columns:
    """Level boxes side by side along x, in this order,
    of one width about y = 0 and with one underside.
    """

    x: Floats
    """Where the first begins and each ends [m], shape (n + 1,)."""
    top: Floats
    """Height of each [m], shape (n,)."""
    width: float
    """[m]."""
    bottom: float
    """Underside [m]."""

    @classmethod
    def of(cls, boxes: Sequence[Box]) -> "Columns | None":
        """Boxes as columns side by side along x; None where they are none."""
        first = boxes[0]
        is_wide = first.low[1] == -first.high[1] and all(
            box.is_level and box.low[1:] == first.low[1:] and box.high[1] == first.high[1]
            for box in boxes
        )
        if not is_wide or any(a.high[0] != b.low[0] for a, b in pairwise(boxes)):
            return None
        return cls(
            x=np.array([first.low[0], *(box.high[0] for box in boxes)]),
            top=np.array([box.high[2] for box in boxes]),
            width=first.high[1] - first.low[1],
            bottom=first.low[2],
        )

    def height_at(self, x: Array) -> Array:
        """Height [m] at world x [m], an array of any shape."""
        xp = namespace(x)
        heights = column_heights(self.x[1:-1], self.top, xp.reshape(x, (-1,)))
        return xp.reshape(heights, x.shape)


def column_heights(walls: Floats, tops: Floats, x: Array) -> Array:
    """Height of columns: at a wall, the higher side; beyond both ends the outermost go on.

    Args:
        walls: Boundaries between columns [m], ascending; shape (n - 1,), or (robots, n - 1) where
            robots differ.
        tops: Height of each [m], shape (n,) or (robots, n).
        x: World x [m], numpy or torch, shape (points,) or (robots, points).
    """
    xp = namespace(x)
    # The dtype of x decides: a boundary is compared in the precision in which x is known.
    walls, tops = (
        xp.astype(xp.asarray(value, device=x.device), x.dtype) for value in (walls, tops)
    )
    # A wall counts backward, and forward
    if tops.ndim == 1:
        behind, ahead = (xp.searchsorted(walls, x, side=side) for side in ("left", "right"))
        return xp.maximum(xp.take(tops, behind, axis=0), xp.take(tops, ahead, axis=0))
    behind = xp.sum(xp.astype(x[..., None] > walls[..., None, :], xp.int64), axis=-1)
    ahead = xp.sum(xp.astype(x[..., None] >= walls[..., None, :], xp.int64), axis=-1)
    return xp.maximum(
        xp.take_along_axis(tops, behind, axis=1), xp.take_along_axis(tops, ahead, axis=1)
    )
