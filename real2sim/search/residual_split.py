"""The split of a log: residuals for fits, for the comparison of models, and for the test.

Rules:

1. If a condition has several segments that look like repeats, because the model without effects
   leaves similar gaps in them, one of them is the test: the last of the first condition, the one
   before of the next, and so on.
2. If the segments of a condition differ, e.g. by amplitude, or if there is only one, each is cut
   into pieces, and every third piece is a test. Fit and test then both see an effect that only the
   largest amplitude shows.
3. A piece in which nothing is known (all its residuals are 0) is no test, and is not counted.
4. Everything else is for fitting. Models are compared by cross-validation; each fold holds out one
   segment or piece.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.problem import Problem

Mask = NDArray[np.bool_]

PIECE_S = 2.0
"""Duration of a piece of a long segment; joints under PD control remember far less."""
SHORTEST_PIECE_S = 0.5
"""Shortest pieces: shorter segments are not cut into three."""
CHUNK_S = 0.5
"""Duration over which residuals may be correlated; unit of the bootstrap and of robust covariances.
It is two periods of the slowest oscillation of a leg of small quadrupeds, about 4 Hz."""
REPEAT_RATIO = 1.5
"""Largest ratio of the RMS gaps of repeats; different amplitudes differ by 2 in practice."""
TEST = -1
"""Fold of the test, which no fit sees."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualSplit:
    """Which residuals are fitted, held out or kept for the test: assignment to chunks and folds."""

    chunk: Indices
    """Chunk of each residual, shape (m,)."""
    fold: Indices
    """Fold that holds each chunk out, or `TEST`, shape (chunks,)."""
    segment: Indices
    """Segment of each chunk, shape (chunks,)."""

    @property
    def folds(self) -> list[int]:
        """The folds of the cross-validation."""
        return [int(fold) for fold in np.unique(self.fold) if fold != TEST]

    @property
    def is_fit(self) -> Mask:
        """Mask of the residuals that fits see, shape (m,)."""
        return self.fold[self.chunk] != TEST


def split_residuals(problem: Problem, residuals: Floats) -> ResidualSplit:
    """Splits a problem's residuals.

    Those of the model without effects, shape (blocks, m), tell repeats from different amplitudes.
    """
    power = np.mean(residuals**2, axis=0)
    pieces: list[tuple[Indices, int]] = []  # rows and segment
    test: list[bool] = []
    for number, condition in enumerate(
        dict.fromkeys(segment.condition for segment in problem.segments)
    ):
        members = [i for i, s in enumerate(problem.segments) if s.condition == condition]
        rows = {i: np.flatnonzero(problem.segment == i) for i in members}
        members = [i for i in members if len(rows[i])]
        levels = [float(np.sqrt(np.mean(power[rows[i]]))) for i in members]
        if len(members) >= 2 and max(levels) <= REPEAT_RATIO * min(levels):
            pieces += [(rows[i], i) for i in members]
            # the last of one condition, the one before of the next: fits see early and late, for
            # what changes with time
            test += [i == members[-1 - number % len(members)] for i in members]
            continue
        for turn, i in enumerate(members):
            time_s, is_known = problem.time_s[rows[i]], power[rows[i]] > 0.0
            known_s = time_s[is_known] if is_known.any() else time_s
            cut = _cut(
                time_s, float(np.clip(np.ptp(known_s) / 3.0, SHORTEST_PIECE_S, PIECE_S)), known_s
            )
            pieces += [(rows[i][part], i) for part in cut]
            tells = [bool(is_known[part].any()) for part in cut]
            # not the same part of each: the end of a sweep is its purpose
            turns = np.cumsum(tells) - 1 + turn
            test += [sum(tells) >= 3 and tells[k] and turns[k] % 3 == 2 for k in range(len(cut))]
    if not any(test):  # many short segments that differ: some of them must be the test
        test = [k % 3 == 2 for k in range(len(test))]
    return _number(problem, pieces, test)


def _number(problem: Problem, pieces: list[tuple[Indices, int]], test: list[bool]) -> ResidualSplit:
    chunk = np.zeros(len(problem.time_s), dtype=np.int64)
    fold: list[int] = []
    segment: list[int] = []
    folds = 0
    for (rows, index), is_test in zip(pieces, test, strict=True):
        for part in _cut(problem.time_s[rows], CHUNK_S):
            chunk[rows[part]] = len(fold)
            fold.append(TEST if is_test else folds)
            segment.append(index)
        folds += not is_test
    return ResidualSplit(chunk=chunk, fold=np.array(fold), segment=np.array(segment))


def _cut(time_s: Floats, length_s: float, known_s: Floats | None = None) -> list[Indices]:
    """Rows of the parts when a stretch is cut into parts of equal duration,
    at least `length_s` each.

    What lies before and after `known_s`, by default all of `time_s`, goes with the first and the
    last part.
    """
    known_s = time_s if known_s is None else known_s
    start, duration = float(known_s.min()), float(np.ptp(known_s))
    parts = max(1, int(duration / length_s))
    edges = start + duration * np.arange(parts + 1) / parts
    edges[0], edges[-1] = -np.inf, np.inf
    rows = [np.flatnonzero((time_s >= low) & (time_s < high)) for low, high in pairwise(edges)]
    return [part for part in rows if len(part)]


CHANCE = 4.0
"""Structure of white noise in a cell of n rows scatters by 1/sqrt(n), in one of few rows, of which
power alone tells, by sqrt(2/n). Four times as much is rare among 1000 cells."""
RESIDUE = 1.5
"""Mean structure of noise that is almost white in cells of `FEW` rows or more, in units of
1/sqrt(n): values below 0 count as 0."""
FEW = 10
"""Rows of a cell below which neighbours say nothing, e.g. where a row is a count over a whole
segment."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualCells:
    """Residuals of a problem sorted by segment and signal.

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
    def of(cls, problem: Problem, mask: Mask) -> "ResidualCells":
        """Cells of the rows in a mask of shape (m,)."""
        rows = np.flatnonzero(mask)
        order = np.lexsort((problem.time_s[rows], problem.signal[rows], problem.segment[rows]))
        rows = rows[order]
        key = problem.segment[rows] * len(problem.signals) + problem.signal[rows]
        starts = np.flatnonzero(np.diff(key, prepend=-1))
        return cls(
            rows=rows,
            starts=starts,
            segment=problem.segment[rows[starts]],
            signal=problem.signal[rows[starts]],
        )

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

        Structure raises the mean square above 1 and correlates neighbours in time. Noise with
        another level does only the first, noise with another colour only the second: the smaller of
        the two counts.
        """
        return np.maximum(0.0, self.beyond_noise(residuals))

    def beyond_noise(self, residuals: Floats) -> Floats:
        """Mean square in each cell beyond noise, as `structure`, but it may be below 0:
        noise alone then sums to about 0 over many cells.
        """
        return np.minimum(*self._beyond_noise(residuals))

    def together(self, residuals: Floats) -> float:
        """Sum of squares beyond noise of all blocks and cells as if they were one.

        Of noise alone a sum of `beyond_noise` is below 0, as each cell takes the smaller of two.
        """
        return min(float(np.sum(way @ self.counts)) for way in self._beyond_noise(residuals))

    def _beyond_noise(self, residuals: Floats) -> tuple[Floats, Floats]:
        """Power above that of noise, and of neighbours that are alike; each (..., cells)."""
        ordered = residuals[..., self.rows]
        products = ordered[..., 1:] * ordered[..., :-1]
        products = np.concatenate([products, np.zeros_like(products[..., :1])], axis=-1)
        products[..., self.starts[1:] - 1] = 0.0  # neighbours of different cells
        alike = np.add.reduceat(products, self.starts, axis=-1) / np.maximum(1, self.counts - 1)
        alike = np.where(self.counts < FEW, np.inf, alike)
        return self.power(residuals) - 1.0, np.asarray(alike)

    def shows(self, structure: Floats, least_rms: float) -> Mask:
        """Cells whose structure has at least this RMS and is not chance, shape of `structure`."""
        return np.asarray(structure > np.maximum(least_rms**2, self._chance))

    def tells(self, structure: Floats, gain_nats: float) -> Mask:
        """True for cells of many rows, and for those of few whose structure is worth this gain
        [nats]; shape of `structure`.
        """
        return np.asarray((self.counts >= FEW) | (structure * self.counts >= 2.0 * gain_nats))

    @property
    def _chance(self) -> Floats:
        """Structure that noise may show in each cell, shape (cells,)."""
        return CHANCE * np.sqrt(np.where(self.counts < FEW, 2.0, 1.0) / self.counts)

    def share_gone(self, before: Floats, after: Floats, shows: Mask) -> float:
        """Share of the structure in some cells that is gone,
        without what chance leaves; 1 if there was none.

        Cells count equally, however many rows they have: one lost image in ten is as much of a gap
        as a bent floor. Of few rows chance may leave as much as would not show, but no larger part
        of what was there than in a cell that hardly shows.
        """
        total = float(before[shows].sum())
        few = np.minimum(self._chance, RESIDUE / CHANCE * before)
        residue = np.where(self.counts < FEW, few, RESIDUE / np.sqrt(self.counts))
        left = np.maximum(0.0, after - residue)
        return 1.0 - float(left[shows].sum()) / total if total > 0.0 else 1.0

    def rms(self, structure: Floats) -> Floats:
        """RMS of the structure in each cell, without what chance may add; shape of `structure`."""
        return np.asarray(np.sqrt(np.maximum(structure - self._chance, 0.0)))

    def largest_rms(self, structure: Floats) -> float:
        """RMS of the structure in the cell that shows most, without what chance may add."""
        return float(np.max(self.rms(structure), initial=0.0))
