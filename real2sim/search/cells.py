"""Residuals by block, segment and signal: where a gap shows, and how much of it is structure instead of noise."""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.search.split import Mask

CHANCE = 4.0
"""Structure of white noise in a cell of n rows scatters by 1/sqrt(n). Four times as much is rare among 1000 cells."""
RESIDUE = 1.5
"""Mean structure of noise that is almost white, in units of 1/sqrt(n): values below 0 count as 0."""
FEW = 10
"""Rows of a cell below which neighbours say nothing, e.g. where a row is a count over a whole segment."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Cells:
    """The rows of a problem sorted by segment and signal.

    Attributes:
        rows: Rows in order of cell, then time, shape (rows,).
        starts: Index in `rows` at which each cell begins, shape (cells,).
        segment: Segment of each cell.
        signal: Signal of each cell.
    """

    rows: Indices
    starts: Indices
    segment: Indices
    signal: Indices

    @classmethod
    def of(cls, problem: Problem, mask: Mask) -> "Cells":
        """Cells of the rows in a mask of shape (m,)."""
        rows = np.flatnonzero(mask)
        order = np.lexsort((problem.time_s[rows], problem.signal[rows], problem.segment[rows]))
        rows = rows[order]
        key = problem.segment[rows] * len(problem.signals) + problem.signal[rows]
        starts = np.flatnonzero(np.diff(key, prepend=-1))
        return cls(rows=rows, starts=starts, segment=problem.segment[rows[starts]], signal=problem.signal[rows[starts]])

    @property
    def counts(self) -> Indices:
        """Rows of each cell."""
        return np.diff(np.append(self.starts, len(self.rows)))

    def power(self, residuals: Floats) -> Floats:
        """Mean square in each cell, shape (..., cells), of residuals of shape (..., m)."""
        squares = residuals[..., self.rows] ** 2
        return np.asarray(np.add.reduceat(squares, self.starts, axis=-1) / self.counts)

    def structure(self, residuals: Floats) -> Floats:
        """Mean square in each cell beyond noise, shape (..., cells), never below 0.

        Structure raises the mean square above 1 and correlates neighbours in time. Noise with another level does only
        the first, noise with another colour only the second: the smaller of the two counts.
        """
        ordered = residuals[..., self.rows]
        products = ordered[..., 1:] * ordered[..., :-1]
        products = np.concatenate([products, np.zeros_like(products[..., :1])], axis=-1)
        products[..., self.starts[1:] - 1] = 0.0  # neighbours of different cells
        alike = np.add.reduceat(products, self.starts, axis=-1) / np.maximum(1, self.counts - 1)
        alike = np.where(self.counts < FEW, np.inf, alike)
        return np.asarray(np.maximum(0.0, np.minimum(self.power(residuals) - 1.0, alike)))

    def shows(self, structure: Floats, least_rms: float) -> Mask:
        """Cells whose structure has at least this RMS and is not chance, shape of `structure`."""
        return np.asarray(structure > np.maximum(least_rms**2, CHANCE / np.sqrt(self.counts)))

    def share_gone(self, before: Floats, after: Floats, shows: Mask) -> float:
        """Share of the structure in some cells that is gone, without what chance leaves; 1 if there was none.

        Cells count equally, however many rows they have: one lost image in ten is as much of a gap as a bent floor.
        """
        total = float(before[shows].sum())
        left = np.maximum(0.0, after - RESIDUE / np.sqrt(self.counts))
        return 1.0 - float(left[shows].sum()) / total if total > 0.0 else 1.0

    def largest_rms(self, structure: Floats) -> float:
        """RMS of the structure in the cell that shows most, without what chance may add."""
        return float(np.sqrt(np.max(structure - CHANCE / np.sqrt(self.counts), initial=0.0)))
