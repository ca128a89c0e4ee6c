"""Effects of a profile that a log contradicts, or of which it shows nothing."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.search.decide import CLEAR_SHARE, REMAINDER_SHARE, ModelComparison
from saltus.real2sim.search.fit import Evaluator, Fit, refine, renewed
from saltus.real2sim.search.reported import StatedModel, is_as_good

BESIDE = 3
"""Number of single effects beside which effects of the profile are taken out: what is missing besides may hide them."""
NOT_REACHED = "with and without the profile's, the log is simulated alike: it does not reach it"


def unseen_of(problem: Problem, comparison: ModelComparison, null: Fit) -> dict[str, str]:
    """Effects of the profile that change nothing in the log by `SIZE_RMS`, and what is said of them."""
    unknowns = null.unknowns[np.newaxis]
    traces = {name: each.residuals(unknowns)[0] - null.residuals for name, each in problem.leaner().items()}
    largest = {name: np.sqrt(comparison.cells.power(trace).max()) for name, trace in traces.items()}
    return {name: NOT_REACHED for name, rms in largest.items() if rms < comparison.size}


def misfits_of(
    problem: Problem, comparison: ModelComparison, fits: Sequence[Fit], stated: StatedModel, seen: set[str]
) -> tuple[str, ...]:
    """Effects of the profile that are to go, of those that are `seen`.

    Where the stated model leaves a gap, those without which, and with one effect of `fits` at most, most of it is gone.
    Else those that the model merely moves to where the log does not reach.
    """
    final = stated.residuals
    moved = tuple(name for name in stated.groups if name in seen and _is_idle(problem, comparison, stated, name))
    if not seen or not comparison.is_gap(final):
        return moved
    singles = [each for each in fits if len(each.model) == 1 and each.model[0] not in seen]
    singles.sort(key=lambda each: comparison.cost(each.residuals))
    starts = [*(each for each in fits if not each.model), *singles[:BESIDE]]
    tried = [_without_misfits(problem, comparison, start, seen) for start in starts]
    gone, left = min(tried, key=lambda each: comparison.cost(each[1]))
    return gone if _share_gone(comparison, final, left) >= CLEAR_SHARE else moved


def _is_idle(problem: Problem, comparison: ModelComparison, stated: StatedModel, name: str) -> bool:
    """True where an effect of the profile explains nothing at its stated values.

    Only an effect that is either there or not can be idle: the size of any other may be 0 instead.
    """
    candidates = [candidate for candidate in problem.candidates if candidate.effect == name]
    if all(unknown.stated is None for candidate in candidates for unknown in candidate.unknowns):
        return False
    unknowns = stated.unknowns.copy()
    unknowns[:, comparison.layout.of_effects([name])] = 0.0
    left = problem.leaner()[name].residuals(unknowns[np.newaxis])[0]
    return is_as_good(comparison, left, comparison.cost(stated.residuals))


def _without_misfits(
    problem: Problem, comparison: ModelComparison, fit: Fit, seen: set[str]
) -> tuple[tuple[str, ...], Floats]:
    """Effects of the profile, each of which leaves a good part less when it goes, and the residuals without them."""
    gone: tuple[str, ...] = ()
    while comparison.is_gap(fit.residuals) and (rest := seen - set(gone)):
        leaner = {name: each for name, each in problem.leaner().items() if name in rest}
        residuals = {name: each.residuals(fit.unknowns[np.newaxis])[0] for name, each in leaner.items()}
        name = min(residuals, key=lambda each: comparison.cost(residuals[each]))
        after = _refitted(leaner[name], comparison, replace(fit, residuals=residuals[name]))
        if _share_gone(comparison, fit.residuals, after.residuals) < REMAINDER_SHARE:
            break
        gone, fit, problem = (*gone, name), after, leaner[name]
    return gone, fit.residuals


def _refitted(problem: Problem, comparison: ModelComparison, old: Fit) -> Fit:
    evaluate, stage = Evaluator(problem), "profile"
    fresh = renewed(evaluate, comparison.layout, [old], stage)
    (fit,) = refine(evaluate, comparison.layout, comparison.split, fresh, stage=stage)
    return fit


def _share_gone(comparison: ModelComparison, before: Floats, after: Floats) -> float:
    cells = comparison.cells
    structure = cells.structure(before)
    return cells.share_gone(structure, cells.structure(after), cells.shows(structure, comparison.size))
