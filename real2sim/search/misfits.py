"""Effects of a profile that a log does not show: a simulator without them is much nearer to the log."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.search.decide import CLEAR_SHARE, REMAINDER_SHARE, ModelComparison
from saltus.real2sim.search.fit import Evaluator, Fit, refine, slopes

BESIDE = 3
"""Number of single effects beside which effects of the profile are taken out: what is missing besides may hide them."""


def misfits_of(problem: Problem, comparison: ModelComparison, fits: Sequence[Fit], final: Floats) -> tuple[str, ...]:
    """Effects of the profile that are to go; none where the residuals `final`, shape (blocks, m), hold no gap.

    Without them, and with one effect of `fits` at most, most of what `final` leaves must be gone.
    """
    present = problem.leaner()
    if not present or comparison.cells.largest_rms(comparison.cells.structure(final)) <= comparison.size:
        return ()
    singles = [each for each in fits if len(each.model) == 1 and each.model[0] not in present]
    singles.sort(key=lambda each: _cost(comparison, each.residuals))
    starts = [*(each for each in fits if not each.model), *singles[:BESIDE]]
    tried = [_without_misfits(problem, comparison, start) for start in starts]
    gone, left = min(tried, key=lambda each: _cost(comparison, each[1]))
    return gone if _share_gone(comparison, final, left) >= CLEAR_SHARE else ()


def _without_misfits(problem: Problem, comparison: ModelComparison, fit: Fit) -> tuple[tuple[str, ...], Floats]:
    """Effects of the profile, each of which leaves a good part less when it goes, and the residuals without them."""
    gone: tuple[str, ...] = ()
    while leaner := problem.leaner():
        left = {name: each.residuals(fit.unknowns[np.newaxis])[0] for name, each in leaner.items()}
        name = min(left, key=lambda each: _cost(comparison, left[each]))
        after = _refitted(leaner[name], comparison, replace(fit, residuals=left[name]))
        if _share_gone(comparison, fit.residuals, after.residuals) < REMAINDER_SHARE:
            break
        gone, fit, problem = (*gone, name), after, leaner[name]
    return gone, fit.residuals


def _refitted(problem: Problem, comparison: ModelComparison, old: Fit) -> Fit:
    evaluate, stage = Evaluator(problem), "profile"
    jacobian = slopes(evaluate, comparison.layout, old.unknowns, old.residuals, old.columns, stage)
    (fit,) = refine(evaluate, comparison.layout, comparison.split, [replace(old, jacobian=jacobian)], stage=stage)
    return fit


def _cost(comparison: ModelComparison, residuals: Floats) -> float:
    return float(np.sum(residuals[:, comparison.split.is_fit] ** 2))


def _share_gone(comparison: ModelComparison, before: Floats, after: Floats) -> float:
    cells = comparison.cells
    structure = cells.structure(before)
    return cells.share_gone(structure, cells.structure(after), cells.shows(structure, comparison.size))
