"""Fits of models to the residuals of a problem:
few simulations, many models and all blocks at once.

Levenberg-Marquardt with Broyden's update: a Jacobian is computed once by finite differences, and
every trial corrects it. All models share one call of the problem per iteration. Blocks accept or
reject a step independently, because nothing couples them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.search.quadratic import QuadraticCost, bounded_minimum
from saltus.real2sim.search.residual_split import ResidualSplit, split_residuals
from saltus.real2sim.search.unknowns_layout import STEP, ModelEffects, UnknownsLayout

BATCH = 64
"""Sets of unknowns in one call of a problem, to bound its memory."""
CONVERGED_NATS = 0.5
"""Steps that promise less than this [nats] are not taken: they move no estimate by more than its
standard error."""
ITERATIONS = 5


class ProblemEvaluator:
    """Evaluates a problem's residuals, counts the simulations and reports progress."""

    def __init__(
        self, problem: Problem, progress: Callable[[str, int], None] | None = None
    ) -> None:
        self._problem = problem
        self._progress = progress
        self.evaluations = 0

    def __call__(self, stage: str, unknowns: Floats) -> Floats:
        """Residuals, shape (n, blocks, m), of unknowns of shape (n, blocks, unknowns)."""
        if not len(unknowns):
            return np.zeros((0, unknowns.shape[1], len(self._problem.time_s)))
        self.evaluations += len(unknowns)
        batches = []
        for batch in np.split(unknowns, range(BATCH, len(unknowns), BATCH)):
            batches.append(self._problem.residuals(batch))
            if self._progress is not None:
                self._progress(stage, len(batch))
        return np.concatenate(batches)


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelFit:
    """A model (a set of effects) with the unknowns that its fit has reached so far.

    Attributes:
        model: The effects.
        columns: Columns of the fitted unknowns, shape (k,).
        unknowns: All unknowns, shape (blocks, unknowns).
        residuals: Shape (blocks, m).
        jacobian: Derivatives by `columns`, shape (blocks, k, m).
    """

    model: ModelEffects
    columns: Indices
    unknowns: Floats
    residuals: Floats
    jacobian: Floats

    def quadratic(self, layout: UnknownsLayout, split: ResidualSplit) -> QuadraticCost:
        """The quadratic around the fit."""
        return QuadraticCost.of(
            layout, split, self.columns, self.unknowns, self.residuals, self.jacobian
        )


def slopes(
    evaluate: ProblemEvaluator,
    layout: UnknownsLayout,
    unknowns: Floats,
    residuals: Floats,
    columns: Indices,
    stage: str,
) -> Floats:
    """Jacobian by finite differences away from the nearer bound, shape (blocks, columns, m)."""
    return all_slopes(evaluate, layout, [(unknowns, residuals, columns)], stage)[0]


def all_slopes(
    evaluate: ProblemEvaluator,
    layout: UnknownsLayout,
    points: Sequence[tuple[Floats, Floats, Indices]],
    stage: str,
) -> list[Floats]:
    """`slopes` at several points, of which each has unknowns,
    residuals and columns, by one call of the problem.
    """
    moves = [_moves(layout, unknowns, columns) for unknowns, _, columns in points]
    moved = evaluate(stage, np.concatenate([sets for sets, _ in moves]))
    parts = np.split(moved, np.cumsum([len(sets) for sets, _ in moves])[:-1])
    return [
        np.asarray((part.transpose(1, 0, 2) - residuals[:, np.newaxis]) / step[..., np.newaxis])
        for part, (_, residuals, _), (_, step) in zip(parts, points, moves, strict=True)
    ]


def _moves(layout: UnknownsLayout, unknowns: Floats, columns: Indices) -> tuple[Floats, Floats]:
    """The sets of a finite difference, shape (columns, blocks, unknowns),
    and its steps, shape (blocks, columns).
    """
    here = unknowns[:, columns]
    step = np.where(here == 0.0, layout.first[columns], STEP * layout.scale[columns])
    step = np.where(here + step > layout.high[columns], -step, step)
    sets = np.repeat(unknowns[np.newaxis], len(columns), axis=0)
    for i, column in enumerate(columns):
        sets[i, :, column] += step[:, i]
    return sets, step


def begun(
    evaluate: ProblemEvaluator,
    layout: UnknownsLayout,
    model: ModelEffects,
    columns: Indices,
    unknowns: Floats,
    stage: str,
) -> ModelFit:
    """A model at given unknowns, shape (blocks, unknowns), with residuals and derivatives there."""
    residuals = evaluate(stage, unknowns[np.newaxis])[0]
    jacobian = slopes(evaluate, layout, unknowns, residuals, columns, stage)
    return ModelFit(
        model=model, columns=columns, unknowns=unknowns, residuals=residuals, jacobian=jacobian
    )


def fitted_null(
    problem: Problem, evaluate: ProblemEvaluator, layout: UnknownsLayout
) -> tuple[ModelFit, ResidualSplit]:
    """The fit of the nuisances alone, the model without effects,
    and the split of the log by what it has to explain.
    """
    unknowns = np.tile(problem.absent, (len(problem.blocks), 1))
    start = begun(evaluate, layout, (), layout.nuisances, unknowns, "nuisances")
    own = split_residuals(problem, start.residuals)
    (null,) = refine_fits(evaluate, layout, own, [start], stage="nuisances")
    return null, own


def renew_derivatives(
    evaluate: ProblemEvaluator, layout: UnknownsLayout, fits: Sequence[ModelFit], stage: str
) -> list[ModelFit]:
    """The fits with derivatives at where they are now."""
    if not fits:
        return []
    points = [(each.unknowns, each.residuals, each.columns) for each in fits]
    jacobians = all_slopes(evaluate, layout, points, stage)
    return [
        replace(each, jacobian=jacobian) for each, jacobian in zip(fits, jacobians, strict=True)
    ]


def refine_fits(
    evaluate: ProblemEvaluator,
    layout: UnknownsLayout,
    split: ResidualSplit,
    fits: Sequence[ModelFit],
    *,
    stage: str,
) -> list[ModelFit]:
    """Fits all models together, each from its `ModelFit` with the Jacobian known there."""
    states = [_Descent(fit, layout, split) for fit in fits]
    for _ in range(ITERATIONS):
        active = [(state, trial) for state in states if (trial := state.propose()) is not None]
        if not active:
            break
        residuals = evaluate(stage, np.array([trial for _, trial in active]))
        for (state, trial), r in zip(active, residuals, strict=True):
            state.learn(trial, r)
    shared = [(state, trial) for state in states for trial in state.share()]
    if shared:
        residuals = evaluate(stage, np.array([trial for _, trial in shared]))
        for (state, trial), r in zip(shared, residuals, strict=True):
            state.learn(trial, r)
    return [state.fit for state in states]


def best_of_each(tried: Sequence[ModelFit], split: ResidualSplit) -> list[ModelFit]:
    """Fits of several models from several starts, those of a model joined: the best of each block.

    Nothing couples blocks.
    """
    found = []
    for model in dict.fromkeys(each.model for each in tried):
        own = [each for each in tried if each.model == model]
        best = np.argmin(
            [np.sum(each.residuals[:, split.is_fit] ** 2, axis=1) for each in own], axis=0
        )
        at = best, np.arange(len(best))
        found.append(
            replace(
                own[0],
                unknowns=np.stack([each.unknowns for each in own])[at],
                residuals=np.stack([each.residuals for each in own])[at],
                jacobian=np.stack([each.jacobian for each in own])[at],
            )
        )
    return found


class _Descent:
    """Descent of one model."""

    def __init__(self, fit: ModelFit, layout: UnknownsLayout, split: ResidualSplit) -> None:
        self.fit = fit
        self._low, self._high = layout.low[fit.columns], layout.high[fit.columns]
        self._scale = layout.scale[fit.columns]
        self._has_shape = bool(np.any(layout.is_shape[fit.columns]))
        self._seen = np.flatnonzero(split.is_fit)
        self._damping = np.full(len(fit.unknowns), 1e-3)
        self._is_done = np.zeros(len(fit.unknowns), dtype=bool)

    def propose(self) -> Floats | None:
        """Next unknowns to try, shape (blocks, unknowns); None if no block has anything to gain."""
        trial = self.fit.unknowns.copy()
        for block in np.flatnonzero(~self._is_done):
            jacobian = self.fit.jacobian[block][:, self._seen]
            hessian, gradient = (
                jacobian @ jacobian.T,
                jacobian @ self.fit.residuals[block, self._seen],
            )
            here = self.fit.unknowns[block, self.fit.columns]
            damped = hessian + self._damping[block] * np.diag(np.diag(hessian))
            change = bounded_minimum(damped, gradient, self._low - here, self._high - here)
            promise = -(gradient @ change + 0.5 * change @ hessian @ change)
            self._is_done[block] = promise < CONVERGED_NATS
            if not self._is_done[block]:
                trial[block, self.fit.columns] = here + change
        return None if self._is_done.all() else trial

    def share(self) -> list[Floats]:
        """Unknowns that all blocks try, because one block may be stuck where others are not.

        These are the medians over blocks. If there are shapes, whose minima are far apart, also
        those of the best block.
        """
        if len(self.fit.unknowns) == 1 or not len(self.fit.columns):
            return []
        self._is_done[:] = False
        own = self.fit.unknowns[:, self.fit.columns]
        shared = [np.median(own, axis=0)]
        if self._has_shape:
            shared.append(own[np.argmin(np.sum(self.fit.residuals[:, self._seen] ** 2, axis=1))])
        trials = []
        for values in shared:
            trial = self.fit.unknowns.copy()
            trial[:, self.fit.columns] = values
            trials.append(trial)
        return trials

    def learn(self, trial: Floats, residuals: Floats) -> None:
        """Takes the residuals of a trial: corrects the Jacobian and moves where the cost fell."""
        unknowns, kept = self.fit.unknowns.copy(), self.fit.residuals.copy()
        jacobian = self.fit.jacobian.copy()
        for block in np.flatnonzero(~self._is_done):
            change = (trial - self.fit.unknowns)[block, self.fit.columns]
            if not change.any():
                continue
            weighted = change / self._scale**2
            missed = residuals[block] - kept[block] - change @ jacobian[block]
            jacobian[block] += np.outer(weighted, missed) / (weighted @ change)
            before, after = (np.sum(r[block, self._seen] ** 2) for r in (kept, residuals))
            if after < before:
                unknowns[block], kept[block] = trial[block], residuals[block]
                self._damping[block] = max(self._damping[block] / 5.0, 1e-4)
            else:
                self._damping[block] = min(max(self._damping[block] * 10.0, 0.5), 1e4)
        self.fit = replace(self.fit, unknowns=unknowns, residuals=kept, jacobian=jacobian)
