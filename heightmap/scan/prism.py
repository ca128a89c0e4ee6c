"""Ground that is the same to the side, as stairs, steps and rows of stones are: a profile, and the
direction in which it runs.

A robot that is pushed aside has ground before it that its camera, which looks ahead, never saw. The
network tells smooth ramps there, the best guess over all kinds of ground. Where all that images
showed lies on one profile, the profile says more: on stairs with a push of 15 Ns 105 of 128 robots
on the scan's heights succeed with it, 95 without (docs/scan.md).
"""

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Reals

REACH = 3
"""Cells on either side over which a slope is measured: over one, edges are jagged by the size of a
cell, and no direction stands out (least over greatest power of slopes on stairs 0.21 in the median;
0.15 with three)."""
LEAST_CELLS = 200
"""With a slope in both directions: the tenth part of what one image shows of stairs."""
LARGEST_ACROSS = 0.4
"""Power of slopes across the direction, in parts of that along it: two of three maps of a run on
stairs are below, the others are of level ground before and behind them."""
TURNS = np.radians(np.arange(-8.0, 9.0))
"""Directions that are tried [rad]: those of slopes are up to 5 degrees off."""
TRIED = 4
"""One of so many cells says which direction fits."""
LEAST_EDGE_M = 0.05
"""Rise over `REACH` strips that counts as an edge. Level ground has no direction, and what slopes
evenly the network tells itself."""
LARGEST_SPREAD_M = 0.01
"""Median distance of heights from the profile: twice the error where stairs were seen."""
LEAST_IN_STRIP = 4
"""Cells that make a height of the profile."""
SURE_M, QUANTILE_90 = 0.01, 1.64
"""Half-width of a strip whose cells agree, as of level ground that was seen, and what their
standard deviation adds."""


class Prism(NamedTuple):
    """Profile of ground that is the same to the side, in strips as wide as a cell of its map."""

    ahead: Floats
    """Direction of the profile in the map's axes, a unit vector of shape (2,)."""
    first: int
    """Number of the first strip: its cells are between so many and one more cell ahead."""
    height: Floats
    """Heights of the strips [m], NaN where too little was seen, shape (strips,)."""
    half_width: Floats
    """Half of the 90 % interval of each strip [m], shape (strips,)."""

    @classmethod
    def of(cls, height: Reals, seen: NDArray[np.bool_]) -> Self | None:
        """The profile on which all lies that was seen; None where there is none, or no edge.

        Args:
            height: Of the cells of a map [m], shape (rows, columns).
            seen: True where an image showed it, the same shape.
        """
        heights = np.asarray(height[seen], np.float64)
        if not heights.size or np.ptp(heights) < LEAST_EDGE_M:
            return None
        steepest, cells = _steepest(height, seen), np.argwhere(seen)
        if steepest is None:
            return None
        ahead = _turned_to_fit(steepest, cells[::TRIED], heights[::TRIED])
        strip = np.floor(cells @ ahead).astype(np.int64)
        first = int(strip.min())
        strip -= first
        count = np.bincount(strip)
        mean = np.bincount(strip, heights) / np.maximum(count, 1)
        off = heights - mean[strip]
        counts = count >= LEAST_IN_STRIP
        rises = (mean[REACH:] - mean[:-REACH])[counts[REACH:] & counts[:-REACH]]
        if not rises.size or np.abs(rises).max() < LEAST_EDGE_M:
            return None
        if np.median(np.abs(off)) > LARGEST_SPREAD_M:
            return None
        spread = np.sqrt(np.bincount(strip, off**2) / np.maximum(count, 1))
        return cls(ahead, first, np.where(counts, mean, np.nan), SURE_M + QUANTILE_90 * spread)

    def at(self, place: Reals) -> tuple[Floats, Floats]:
        """Height and half-width [m] at places in cells of the map, shape (n, 2); each of shape
        (n,), heights NaN where the profile is not known.
        """
        strip = np.floor(place @ self.ahead).astype(np.int64) - self.first
        inside = (strip >= 0) & (strip < len(self.height))
        strip = strip.clip(0, len(self.height) - 1)
        return np.where(inside, self.height[strip], np.nan), self.half_width[strip]


def _steepest(height: Reals, seen: NDArray[np.bool_]) -> Floats | None:
    """Direction along which slopes are steepest, a unit vector; None where others are as steep."""
    inner, far, near = slice(REACH, -REACH), slice(2 * REACH, None), slice(None, -2 * REACH)
    sides = ((far, inner), (near, inner)), ((inner, far), (inner, near))
    known = seen[inner, inner].copy()
    for pair in sides:
        for side in pair:
            known &= seen[side]
    if np.count_nonzero(known) < LEAST_CELLS:
        return None
    slopes = np.array([(height[more] - height[less])[known] for more, less in sides], np.float64)
    power, directions = np.linalg.eigh(slopes @ slopes.T)
    return None if power[0] > LARGEST_ACROSS * power[1] else directions[:, 1]


def _turned_to_fit(ahead: Floats, cells: NDArray[np.int64], heights: Floats) -> Floats:
    """The direction near one along which strips differ most, and so are most alike within: slopes
    over some cells lean to the map's diagonals.
    """
    cos, sin = np.cos(TURNS), np.sin(TURNS)
    ways = np.array([cos * ahead[0] - sin * ahead[1], sin * ahead[0] + cos * ahead[1]])
    strip = np.floor(cells @ ways).astype(np.int64)
    strip -= strip.min()
    shape = len(TURNS), int(strip.max()) + 1
    own, size = (strip + shape[1] * np.arange(len(TURNS))).ravel(), shape[0] * shape[1]
    count = np.bincount(own, minlength=size)
    total = np.bincount(own, np.repeat(heights - heights.mean(), len(TURNS)), minlength=size)
    apart = (total**2 / np.maximum(count, 1)).reshape(shape).sum(1)
    return np.asarray(ways[:, np.argmax(apart)])
