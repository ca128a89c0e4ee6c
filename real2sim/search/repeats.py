"""Remainders that differ from repeat to repeat of a motion:
chance, which no effect of a library explains.
"""

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.search.residual_split import ResidualCells

LEAST_REPEATING = 0.5
"""Part of the gap that must repeat: else the motions do not, or there is nothing but chance."""


def closed_of_repeating(
    problem: Problem, tested: ResidualCells, before: Floats, after: Floats, shows: np.ndarray
) -> float:
    """Share that is gone of the structure that repeats, in the cells that show any;
    0 where too little of it repeats.

    What repeats is the mean product of residuals of shape (blocks, m) at one time of two segments
    of one condition. `shows` has the shape (blocks, cells).
    """
    repeated = np.array([len(repeats_of(problem, int(segment))) > 0 for segment in tested.segment])
    shows = shows & repeated
    structure = float(tested.structure(before)[shows].sum())
    first, last = (
        float(_repeating(problem, tested, each)[shows].sum()) for each in (before, after)
    )
    if structure <= 0.0 or first < LEAST_REPEATING * structure:
        return 0.0
    return 1.0 - max(last, 0.0) / first


def _repeating(problem: Problem, tested: ResidualCells, residuals: Floats) -> Floats:
    """Shape (blocks, cells)."""
    found = np.zeros((len(residuals), len(tested.starts)))
    for cell, rows in enumerate(np.split(tested.rows, tested.starts[1:])):
        segment, signal = int(tested.segment[cell]), int(tested.signal[cell])
        own_s, products = problem.time_s[rows] - problem.segments[segment].start_s, []
        for other in repeats_of(problem, segment):
            there = np.flatnonzero((problem.segment == other) & (problem.signal == signal))
            there = there[np.argsort(problem.time_s[there])]
            if len(there):
                other_s = problem.time_s[there] - problem.segments[other].start_s
                again = np.array([np.interp(own_s, other_s, block[there]) for block in residuals])
                products.append(np.mean(residuals[:, rows] * again, axis=1))
        if products:
            found[:, cell] = np.mean(products, axis=0)
    return found


def repeats_of(problem: Problem, segment: int) -> list[int]:
    """Indices of the other segments with the condition of this one."""
    condition = problem.segments[segment].condition
    return [
        i for i, each in enumerate(problem.segments) if each.condition == condition and i != segment
    ]
