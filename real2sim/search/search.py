"""The search for missing effects: which, where, how large, and whether the log can tell them apart.

It knows problems (`saltus.real2sim.problem.problem`), not robots. Steps:

1. Fit the nuisances alone, the model without effects. Split the log
   (`saltus.real2sim.search.residual_split`).
2. Compute derivatives by every unknown there; fit each effect alone.
3. Compute derivatives at the best single effect. There the quadratic approximation shows which
   effects are missing or should be swapped: an effect that explains nothing alone may be half of
   the truth. Fit pairs; repeat at the best pair for swaps and a third effect. Then remove effects
   from the largest model one by one.
4. Compare all fitted models on held-out data and choose (`saltus.real2sim.search.decide`).
5. State places, values and intervals (`saltus.real2sim.search.estimates`), effects that look alike
   (`saltus.real2sim.search.signature`), and the gap on test segments.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.search import conclude, decide, model_fit
from saltus.real2sim.search.choose import choose_among, is_part
from saltus.real2sim.search.findings import SearchFindings
from saltus.real2sim.search.known_fits import PROPOSED, KnownFits
from saltus.real2sim.search.model_fit import ModelFit, ProblemEvaluator
from saltus.real2sim.search.residual_split import ResidualCells, ResidualSplit
from saltus.real2sim.search.unknowns_layout import ModelEffects, UnknownsLayout, with_effects

REFITTED = 4
"""Number of single effects that are refitted with fresh derivatives.

In practice the truth is among the best four.
"""
PATIENCE = 3
"""Rounds of fits with fresh derivatives for unions of two good models, which converge slowly."""
LARGEST = 3
"""Largest number of effects in a model."""
RIVALS = 3
"""Number of models of each size between which is decided with fresh derivatives: the largest set
that is stated."""


def search_effects(
    problem: Problem, *, progress: Callable[[str, int], None] | None = None, seed: int = 0
) -> SearchFindings:
    """Finds the effects that explain the gap between a problem's log and the simulator.

    `progress` is called with the stage and the number of simulations since the last call.
    """
    if not len(problem.time_s):
        return SearchFindings(problem=problem.name, verdict="no_gap", untestable=problem.untestable)
    search = _Search(problem, progress, seed)
    findings = search.run()
    model = findings.residuals.effects if findings.residuals is not None else ()
    alike = problem.replayed_alike(model)
    if alike is problem or findings.verdict not in ("named", "set"):
        return findings
    if not search.is_moved(alike, model):
        return findings
    again = _Search(alike, progress, seed).run()
    return replace(again, evaluations=findings.evaluations + again.evaluations)


class _Search:
    """The stages of a search, one after the other."""

    def __init__(
        self, problem: Problem, progress: Callable[[str, int], None] | None, seed: int
    ) -> None:
        self._problem = problem
        self._layout = UnknownsLayout.of(problem)
        self._evaluate = ProblemEvaluator(problem, progress)
        self._seed = seed
        self._split: ResidualSplit
        self._comparison: decide.ModelComparison
        self._known: KnownFits

    def run(self) -> SearchFindings:
        """The whole search."""
        null, self._split = model_fit.fitted_null(self._problem, self._evaluate, self._layout)
        self._comparison = decide.ModelComparison(
            layout=self._layout,
            split=self._split,
            cells=ResidualCells.of(self._problem, self._split.is_fit),
            rng=np.random.default_rng(self._seed),
            size=decide.SIZE_RMS * self._problem.samples_per_residual**0.5,
            further_share=decide.FURTHER_SHARE * self._problem.simulator_disagreement,
        )
        self._known = KnownFits(
            self._layout, self._split, self._evaluate, null, self._comparison.cost
        )
        if self._is_worth_fitting():
            self._fit_singles()
            for size in range(2, LARGEST + 1):
                best = self._known.best(size - 1)
                if decide.may_gain(self._comparison, self._known.fits[()], self._known.fits[best]):
                    self._fit_larger(best, size)
                elif size == 2:
                    self._fit_told_by_value(best)
            self._refit_rivals()
        return conclude.findings(self._problem, self._comparison, self._evaluate, self._known)

    def is_moved(self, alike: Problem, model: ModelEffects) -> bool:
        """True where a model without one of its effects is another in a replay like that of the
        model, by what counts as an effect: that replay may close what the effect seems to.
        """
        parts = [part for part in self._known.fits.values() if is_part(part.model, model)]
        if not parts:
            return False
        moved = alike.residuals(np.array([part.unknowns for part in parts]))
        change = moved - np.array([part.residuals for part in parts])
        return float(np.sqrt(self._comparison.cells.power(change).max())) > self._comparison.size

    def _is_worth_fitting(self) -> bool:
        """True where the quadratic promises a larger gain than chance from all effects together."""
        quadratic = self._known.quadratic(())
        null = quadratic.where(self._layout.nuisances)
        gain = 0.5 * (quadratic.fit_cost(null) - quadratic.fit_cost(np.ones_like(null)))
        return gain > decide.GAIN_NATS

    def _fit_singles(self) -> None:
        """Fits each effect alone, and the best ones again
        with fresh derivatives and other shapes.
        """
        null = self._known.fits[()]
        starts = [
            start
            for effect in self._layout.effects
            for start in self._known.starts((effect,), null)
        ]
        tried = model_fit.refine_fits(
            self._evaluate, self._layout, self._split, starts, stage="single effects"
        )
        fits = model_fit.best_of_each(tried, self._split)
        self._known.keep(fits)
        best = sorted(fits, key=self._known.cost)[:REFITTED]
        self._refit([each.model for each in best], "single effects")
        self._restart(self._known.best(1), "single effects")
        self._fit_likely()

    def _fit_likely(self) -> None:
        """Fits the model that the problem itself sees, and its parts.

        From none of its effects slopes lead there.
        """
        likely, layout, null = self._problem.likely, self._layout, self._known.fits[()]
        if likely is None:
            return
        model = with_effects(
            [effect for effect in layout.effects if likely[layout.of_effects([effect])].any()]
        )[:LARGEST]
        columns, own = layout.of_model(model), layout.of_effects(model)
        unknowns = null.unknowns.copy()
        unknowns[:, own] = np.clip(likely[own], layout.low[own], layout.high[own])
        self._known.fits[model] = model_fit.begun(
            self._evaluate, layout, model, columns, unknowns, "single effects"
        )
        self._refit([model], "single effects")
        while len(model) > 1:
            self._eliminate(model)
            parts = [with_effects(set(model) - {effect}) for effect in model]
            model = min(parts, key=lambda part: self._known.cost(self._known.fits[part]))

    def _refit(self, models: list[ModelEffects], stage: str) -> None:
        """Renews derivatives of fits and continues them."""
        fresh = model_fit.renew_derivatives(
            self._evaluate, self._layout, [self._known.fits[model] for model in models], stage
        )
        self._known.keep(
            model_fit.refine_fits(self._evaluate, self._layout, self._split, fresh, stage=stage)
        )

    def _fit_larger(self, best_so_far: ModelEffects, size: int) -> None:
        """Fits models of up to `size` effects that the derivatives
        at the best model so far propose.
        """
        others = self._known.others(best_so_far, size - 1)
        for model in (best_so_far, *others):
            self._known.library(model)
            self._fit_union(best_so_far, model, size)
        proposed = self._known.proposed(best_so_far, size)
        for other in others:
            proposed += self._known.proposed(other, size)[: PROPOSED // 2]
        models = dict.fromkeys(model for model in proposed if model not in self._known.fits)
        starts = [
            start
            for model in models
            for part in self._known.parts(model)
            for start in self._known.starts(model, part)
        ]
        fits = model_fit.best_of_each(
            model_fit.refine_fits(
                self._evaluate, self._layout, self._split, starts, stage=f"{size} effects"
            ),
            self._split,
        )
        self._known.keep(fits)
        self._refit(
            [each.model for each in sorted(fits, key=self._known.cost)[:2]], f"{size} effects"
        )
        if any(len(model) == size for model in self._known.fits):
            if size == 2:
                self._restart(self._known.best(size), "2 effects")
            self._eliminate(self._known.best(size))

    def _fit_told_by_value(self, best: ModelEffects) -> None:
        """Fits pairs of the best effect, which leaves little or no gap, and the likeliest others,
        if one of these counts by its value, however little it shows.
        """
        known, layout = self._known, self._layout
        if not best or not self._comparison.is_gap(known.fits[()].residuals):
            return
        quadratic = known.quadratic(best)

        def cost(model: ModelEffects) -> float:
            return quadratic.fit_cost(quadratic.where(layout.of_model(model)))

        def counts(pair: ModelEffects) -> bool:
            free = quadratic.where(layout.of_model(pair))
            moved = [quadratic.solve(block, free) for block in range(len(quadratic.point))]
            (effect,) = set(pair) - set(best)
            return decide.counts_by_value(layout, quadratic.point + np.array(moved), effect)

        others = (effect for effect in layout.effects if effect not in best)
        pairs = sorted((with_effects([*best, effect]) for effect in others), key=cost)[:RIVALS]
        least = cost(best) - 2.0 * decide.GAIN_NATS
        if any(cost(pair) < least and counts(pair) for pair in pairs):
            starts = [start for pair in pairs for start in known.starts(pair, known.fits[best])]
            tried = model_fit.refine_fits(
                self._evaluate, layout, self._split, starts, stage="2 effects"
            )
            known.keep(model_fit.best_of_each(tried, self._split))
            self._refit(pairs, "2 effects")

    def _fit_union(self, best_so_far: ModelEffects, other: ModelEffects, size: int) -> None:
        """Fits the union of two good models; where they imitate each other, both have far to go."""
        model = with_effects([*best_so_far, *other])
        if len(model) != size or model in self._known.fits:
            return
        stage, parts = f"{size} effects", [self._known.fits[part] for part in (best_so_far, other)]
        fits = [start for part in parts for start in self._known.starts(model, part)]
        for patience in range(PATIENCE):
            if patience:
                fits = model_fit.renew_derivatives(self._evaluate, self._layout, fits, stage)
            fits = model_fit.refine_fits(
                self._evaluate, self._layout, self._split, fits, stage=stage
            )
        (self._known.fits[model],) = model_fit.best_of_each(fits, self._split)

    def _refit_rivals(self) -> None:
        """Continues the best models that explain the gap, and renews their derivatives.

        The cost on held-out data follows from derivatives; old ones made one of two models that
        look alike 90 nats worse.
        """
        null, models = self._known.fits[()], list[ModelEffects]()
        for size in range(1, LARGEST + 1):
            explain = [
                each
                for each in self._known.of_size(size)
                if decide.explains(self._comparison, null, each)
            ]
            models += [each.model for each in explain[:RIVALS]]
        self._keep_better(self._from_above(models), "rivals")
        self._refit(models, "rivals")
        # what the descent corrected on its way is not what the derivatives are at its end
        rivals = [self._known.fits[model] for model in models]
        self._known.keep(
            model_fit.renew_derivatives(self._evaluate, self._layout, rivals, "rivals")
        )
        self._refit_parts()

    def _refit_parts(self) -> None:
        """Fits the chosen model without each of its effects, from its values, until it stays.

        What an effect adds to a poor fit of the others it may not explain.
        """
        tried: set[ModelEffects] = set()
        while True:
            fits = self._known.fits.values()
            model = choose_among(self._comparison, fits).chosen.fit.model
            if len(model) < 2 or model in tried:
                return
            tried.add(model)
            self._eliminate(model)

    def _from_above(self, models: list[ModelEffects]) -> list[ModelFit]:
        """Starts of models from fits of one more effect that promise a gain.

        What these found for the nuisances may be the better minimum.
        """
        starts: list[ModelFit] = []
        for model in models:
            known = self._known.fits[model]
            above = [
                each.model
                for each in self._known.of_size(len(model) + 1)
                if set(model) < set(each.model)
            ]
            starts += [
                start
                for start in self._reduced([(each, model) for each in above[:RIVALS]], "rivals")
                if start.quadratic(self._layout, self._split).fit_cost(
                    np.ones(len(start.columns), dtype=bool)
                )
                < self._known.cost(known) - 2.0 * decide.GAIN_NATS
            ]
        return starts

    def _restart(self, model: ModelEffects, stage: str) -> None:
        """Refits a model from all known shapes of its effects, if it leaves structure.

        A poorly fitting shape may still be a local minimum, in some blocks or in all.
        """
        if not self._comparison.is_gap(self._known.fits[model].residuals):
            return
        layout, here = self._layout, self._known.fits[model]
        points, moving = [], []
        for effect in model:
            columns = layout.of_effects([effect])
            shaped = columns[layout.is_shape[columns]]
            for shape in self._shapes(effect) if len(shaped) else []:
                unknowns = here.unknowns.copy()
                unknowns[:, shaped] = shape
                points.append(unknowns)
                moving.append(columns)
        starts = [here]
        if points:
            residuals = self._evaluate(stage, np.array(points))
            at = list(zip(points, residuals, moving, strict=True))
            for (unknowns, r, columns), own in zip(
                at, model_fit.all_slopes(self._evaluate, layout, at, stage), strict=True
            ):
                jacobian = here.jacobian.copy()
                jacobian[:, np.isin(here.columns, columns)] = own
                starts.append(replace(here, unknowns=unknowns, residuals=r, jacobian=jacobian))
            tried = model_fit.refine_fits(self._evaluate, layout, self._split, starts, stage=stage)
            self._known.keep(model_fit.best_of_each(tried, self._split))
            self._known.forget(model)
            self._refit([model], stage)

    def _shapes(self, effect: str) -> list[Floats]:
        """Shapes from which fits of an effect start, equal at all places.

        Shape (its shape unknowns,).
        """
        layout = self._layout
        own = [i for i, candidate in enumerate(layout.candidates) if candidate.effect == effect]
        count = min(len(layout.starts(i)) for i in own)
        return [
            np.concatenate(
                [layout.starts(i)[k][layout.is_shape[layout.of_candidate(i)]] for i in own]
            )
            for k in range(count)
        ]

    def _eliminate(self, model: ModelEffects) -> None:
        """Refits the model without each of its effects, from its values:
        this may leave a poor minimum.
        """
        parts = [with_effects(set(model) - {effect}) for effect in model]
        self._keep_better(
            self._reduced([(model, part) for part in parts], "elimination"), "elimination"
        )

    def _reduced(self, ways: list[tuple[ModelEffects, ModelEffects]], stage: str) -> list[ModelFit]:
        """Starts of models, the second of each way, from the values of larger ones, the first."""
        points = []
        for larger, part in ways:
            idle = self._layout.of_effects(set(larger) - set(part))
            unknowns = self._known.fits[larger].unknowns.copy()
            unknowns[:, idle] = self._known.rest[:, idle]
            points.append(unknowns)
        if not points:
            return []
        starts = []
        for (larger, part), unknowns, r in zip(
            ways, points, self._evaluate(stage, np.array(points)), strict=True
        ):
            full, columns = self._known.fits[larger], self._layout.of_model(part)
            jacobian = full.jacobian[:, np.isin(full.columns, columns)]
            starts.append(
                ModelFit(
                    model=part, columns=columns, unknowns=unknowns, residuals=r, jacobian=jacobian
                )
            )
        return starts

    def _keep_better(self, starts: list[ModelFit], stage: str) -> None:
        """Refines starts, and keeps those that end below the known fits of their models."""
        tried = model_fit.refine_fits(
            self._evaluate, self._layout, self._split, starts, stage=stage
        )
        known = self._known.fits
        better = [
            each
            for each in model_fit.best_of_each(tried, self._split)
            if each.model not in known
            or self._known.cost(each) < self._known.cost(known[each.model])
        ]
        self._known.keep(better)
        for each in better:
            self._known.forget(each.model)
        self._refit([each.model for each in better], stage)
