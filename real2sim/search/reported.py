"""The values that a verdict states, fitted again where places share them,
and what of a profile a log contradicts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.search import decide, estimates, model_fit
from saltus.real2sim.search.decide import CLEAR_SHARE, REMAINDER_SHARE, ModelComparison, ScoredFit
from saltus.real2sim.search.model_fit import (
    ModelFit,
    ProblemEvaluator,
    refine_fits,
    renew_derivatives,
)
from saltus.real2sim.search.quadratic import bounded_minimum
from saltus.real2sim.search.unknowns_layout import ModelEffects

ITERATIONS = 3
"""Gauss-Newton iterations with fresh derivatives; values start within a few errors of their end."""
HALVINGS = 3
"""Halvings of a step that does not help: a value that can only be stated as 1 may be far from the
fitted one."""
AS_GOOD = 1.1
"""Ratio of costs up to which a statement is as good as the best one: values of equal drives scatter
by 10 % (`estimates.SAME`)."""

Groups = dict[str, list[estimates.EffectGroup]]


@dataclass(frozen=True, kw_only=True, eq=False)
class StatedModel:
    """Groups of each effect, all unknowns, shape (blocks, unknowns),
    and the residuals that they leave.
    """

    groups: Groups
    unknowns: Floats
    residuals: Floats


def stated_model(
    problem: Problem,
    comparison: ModelComparison,
    evaluate: ProblemEvaluator,
    null: ScoredFit,
    chosen: ScoredFit,
) -> StatedModel:
    """The simplest statement of the chosen model that explains the log as well as the fit does.

    Statements, simplest first: values that places share; separate values where the effect is
    present; separate values wherever it leaves a trace, however uncertain they are. A patch with
    less would not explain the log.
    """
    model = chosen.fit.model
    if not model:
        return StatedModel(groups={}, unknowns=chosen.fit.unknowns, residuals=chosen.fit.residuals)
    places = {
        effect: estimates.places_of(problem, comparison, chosen.fit, effect) for effect in model
    }
    ways: tuple[Groups, ...] = (
        {
            effect: estimates.group(problem, found, comparison.size)
            for effect, found in places.items()
        },
        {
            effect: estimates.each_alone(problem, found, comparison.size)
            for effect, found in places.items()
        },
        {effect: estimates.each_trace(found, comparison.size) for effect, found in places.items()},
    )
    tried: list[StatedModel] = []
    for k, way in enumerate(ways):
        same = [one for one, other in zip(tried, ways[:k], strict=True) if _is_same(way, other)]
        if not same:
            same = [_TiedModel(problem, comparison, chosen.fit, way).fitted(evaluate)]
        tried.append(same[0])
    least = decide.explained_share(comparison, model)
    lowest = min(comparison.cost(one.residuals) for one in tried)
    for one in tried:
        closed = comparison.closed(
            null, null, replace(chosen, structure=comparison.cells.structure(one.residuals))
        )
        if closed >= least and is_as_good(comparison, one.residuals, lowest):
            return one
    if problem.leaner():  # added to a profile, a patch gives what is stated, not what was fitted
        return min(tried, key=lambda one: comparison.cost(one.residuals))
    # no statement is as good as the fit: keep the fitted unknowns
    return StatedModel(
        groups=tried[-1].groups, unknowns=chosen.fit.unknowns, residuals=chosen.fit.residuals
    )


def _is_same(one: Groups, other: Groups) -> bool:
    """True where two statements of a model are one: the same values at the same places."""
    first, second = (
        [
            ([(place.block, place.candidate) for place in group.places], group.value.tolist())
            for groups in way.values()
            for group in groups
        ]
        for way in (one, other)
    )
    return first == second


def without_little(
    comparison: ModelComparison,
    fits: dict[ModelEffects, ModelFit],
    fit: ModelFit,
    groups: Groups,
) -> ModelEffects:
    """The other effect of a pair of which one shows little and is stated with a value that does not
    count: the largest of its fitted values did, and may be noise. Empty: it is no such pair.
    """
    for effect in fit.model if len(fit.model) == 2 else ():
        rest = tuple(other for other in fit.model if other != effect)
        if rest not in fits or not groups[effect]:
            continue
        candidate = comparison.layout.candidates[groups[effect][0].places[0].candidate]
        least = decide.least_value(candidate)
        largest = max(abs(float(group.value[0])) for group in groups[effect])
        shown = decide.largest_rms(comparison, fits, fit, effect)
        if shown < decide.BESIDE * comparison.size and largest < least < np.inf:
            return rest
    return ()


def is_as_good(comparison: ModelComparison, residuals: Floats, lowest: float) -> bool:
    """True where residuals show no gap, or cost hardly more than those of the best statement."""
    return not comparison.is_gap(residuals) or comparison.cost(residuals) <= AS_GOOD * lowest


class _TiedModel:
    """A model in which the places of a group share one value, and other places lack the effect.

    The nuisances and shapes of `start` are kept where no group sets them.
    """

    def __init__(
        self,
        problem: Problem,
        comparison: ModelComparison,
        start: model_fit.ModelFit,
        groups: Groups,
    ) -> None:
        self._comparison, self._start, self._groups = comparison, start, groups
        layout = comparison.layout
        self._rest = start.unknowns.copy()
        sized = layout.of_effects(start.model)
        self._rest[:, sized[~layout.is_shape[sized]]] = 0.0
        # for each fitted number: the blocks and columns of the vector of unknowns that it sets
        self._seats: list[list[tuple[int, int]]] = []
        values: list[float] = []
        stated: list[float] = []
        for group in (group for several in groups.values() for group in several):
            columns = [layout.of_candidate(place.candidate) for place in group.places]
            unknowns = problem.candidates[group.places[0].candidate].unknowns
            for i, value in enumerate(group.value):
                stated.append(np.nan if (told := unknowns[i].stated) is None else told)
                self._seats.append(
                    [(p.block, int(c[i])) for p, c in zip(group.places, columns, strict=True)]
                )
                values.append(float(value))
        for column in layout.nuisances:
            for block in range(len(start.unknowns)):
                self._seats.append([(block, int(column))])
                values.append(float(start.unknowns[block, column]))
                stated.append(np.nan)
        own = [seats[0][1] for seats in self._seats]
        self._low, self._high = (
            np.where(np.isnan(stated), b[own], stated) for b in (layout.low, layout.high)
        )
        self._values = np.clip(np.array(values), self._low, self._high)

    def fitted(self, evaluate: ProblemEvaluator) -> StatedModel:
        """Fits by Gauss-Newton; stops at the first step that does not help."""
        values = self._values
        unknowns = self._unknowns(values)
        residuals = evaluate("reported values", unknowns[np.newaxis])[0]
        for _ in range(ITERATIONS):
            if not self._comparison.is_gap(residuals):
                break
            change = self._change(evaluate, values, unknowns, residuals)
            shares = 0.5 ** np.arange(1 + HALVINGS)
            trials = np.clip(values + shares[:, np.newaxis] * change, self._low, self._high)
            moved = np.array([self._unknowns(trial) for trial in trials])
            left = evaluate("reported values", moved)
            best = int(np.argmin([self._comparison.cost(each) for each in left]))
            if self._comparison.cost(left[best]) >= self._comparison.cost(residuals):
                break
            values, unknowns, residuals = trials[best], moved[best], left[best]
        return StatedModel(groups=self._regrouped(values), unknowns=unknowns, residuals=residuals)

    def _change(
        self, evaluate: ProblemEvaluator, values: Floats, unknowns: Floats, residuals: Floats
    ) -> Floats:
        layout, seen = self._comparison.layout, self._comparison.split.is_fit
        columns = np.unique([column for seats in self._seats for _, column in seats])
        jacobian = model_fit.slopes(
            evaluate, layout, unknowns, residuals, columns, "reported values"
        )[:, :, seen]
        count = len(self._seats)
        tied = np.zeros((len(residuals), len(columns), count))
        for i, seats in enumerate(self._seats):
            for block, column in seats:
                tied[block, np.searchsorted(columns, column), i] = 1.0
        hessian, gradient = np.zeros((count, count)), np.zeros(count)
        for block, r in enumerate(residuals[:, seen]):
            own = tied[block]
            hessian += own.T @ (jacobian[block] @ jacobian[block].T) @ own
            gradient += own.T @ (jacobian[block] @ r)
        return bounded_minimum(hessian, gradient, self._low - values, self._high - values)

    def _unknowns(self, values: Floats) -> Floats:
        unknowns = self._rest.copy()
        for value, seats in zip(values, self._seats, strict=True):
            for block, column in seats:
                unknowns[block, column] = value
        return unknowns

    def _regrouped(self, values: Floats) -> Groups:
        """The groups with fitted values, in their order."""
        at = 0
        found: Groups = {}
        for effect, groups in self._groups.items():
            found[effect] = []
            for group in groups:
                found[effect].append(replace(group, value=values[at : at + len(group.value)]))
                at += len(group.value)
        return found


BESIDE = 3
"""Number of single effects beside which effects of the profile are taken out: what is missing
besides may hide them."""
NOT_REACHED = "with and without the profile's, the log is simulated alike: it does not reach it"


def unseen_of(problem: Problem, comparison: ModelComparison, null: ModelFit) -> dict[str, str]:
    """Effects of the profile that change nothing in the log by `SIZE_RMS`,
    and what is said of them.
    """
    unknowns = null.unknowns[np.newaxis]
    traces = {
        name: each.residuals(unknowns)[0] - null.residuals
        for name, each in problem.leaner().items()
    }
    largest = {name: np.sqrt(comparison.cells.power(trace).max()) for name, trace in traces.items()}
    return {name: NOT_REACHED for name, rms in largest.items() if rms < comparison.size}


def misfits_of(
    problem: Problem,
    comparison: ModelComparison,
    fits: Sequence[ModelFit],
    stated: StatedModel,
    seen: set[str],
) -> tuple[str, ...]:
    """Effects of the profile that are to go, of those that are `seen`.

    Where the stated model leaves a gap, those without which, and with one effect of `fits` at most,
    most of it is gone. Else those that the model merely moves to where the log does not reach.
    """
    final = stated.residuals
    moved = tuple(
        name
        for name in stated.groups
        if name in seen and _is_idle(problem, comparison, stated, name)
    )
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
    problem: Problem, comparison: ModelComparison, fit: ModelFit, seen: set[str]
) -> tuple[tuple[str, ...], Floats]:
    """Effects of the profile, each of which leaves a good part less when it goes,
    and the residuals without them.
    """
    gone: tuple[str, ...] = ()
    while comparison.is_gap(fit.residuals) and (rest := seen - set(gone)):
        leaner = {name: each for name, each in problem.leaner().items() if name in rest}
        residuals = {
            name: each.residuals(fit.unknowns[np.newaxis])[0] for name, each in leaner.items()
        }
        name = min(residuals, key=lambda each: comparison.cost(residuals[each]))
        after = _refitted(leaner[name], comparison, replace(fit, residuals=residuals[name]))
        if _share_gone(comparison, fit.residuals, after.residuals) < REMAINDER_SHARE:
            break
        gone, fit, problem = (*gone, name), after, leaner[name]
    return gone, fit.residuals


def _refitted(problem: Problem, comparison: ModelComparison, old: ModelFit) -> ModelFit:
    evaluate, stage = ProblemEvaluator(problem), "profile"
    fresh = renew_derivatives(evaluate, comparison.layout, [old], stage)
    (fit,) = refine_fits(evaluate, comparison.layout, comparison.split, fresh, stage=stage)
    return fit


def _share_gone(comparison: ModelComparison, before: Floats, after: Floats) -> float:
    cells = comparison.cells
    structure = cells.structure(before)
    return cells.share_gone(
        structure, cells.structure(after), cells.shows(structure, comparison.size)
    )
