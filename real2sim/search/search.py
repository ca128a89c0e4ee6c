"""The search for missing effects: which, where, how large, and whether the log can tell them apart.

It knows problems (`saltus.real2sim.problem.problem`), not robots. Steps:

1. Fit the nuisances alone, the model without effects. Split the log
   (`saltus.real2sim.search.split`).
2. Compute derivatives by every unknown there; fit each effect alone.
3. Compute derivatives at the best single effect. There the quadratic approximation shows which
   effects are missing or should be swapped: an effect that explains nothing alone may be half of
   the truth. Fit pairs; repeat at the best pair for swaps and a third effect. Then remove effects
   from the largest model one by one.
4. Compare all fitted models on held-out data and choose (`saltus.real2sim.search.decide`).
5. State places, values and intervals (`saltus.real2sim.search.estimates`), effects that look alike
   (`saltus.real2sim.search.signature`), and the gap on test segments.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import combinations

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.search import conclude, decide, fit
from saltus.real2sim.search.findings import Findings
from saltus.real2sim.search.fit import Evaluator, Fit
from saltus.real2sim.search.layout import Layout, Model, model_of
from saltus.real2sim.search.quadratic import Quadratic
from saltus.real2sim.search.split import Cells, Split

REFITTED = 4
"""Number of single effects that are refitted with fresh derivatives.

In practice the truth is among the best four.
"""
PROPOSED = 6
"""Number of larger models that are fitted after each set of derivatives."""
PATIENCE = 3
"""Rounds of fits with fresh derivatives for unions of two good models, which converge slowly."""
LARGEST = 3
"""Largest number of effects in a model."""
RIVALS = 3
"""Number of models of each size between which is decided with fresh derivatives: the largest set
that is stated."""


def search(
    problem: Problem, *, progress: Callable[[str, int], None] | None = None, seed: int = 0
) -> Findings:
    """Finds the effects that explain the gap between a problem's log and the simulator.

    `progress` is called with the stage and the number of simulations since the last call.
    """
    if not len(problem.time_s):
        return Findings(problem=problem.name, verdict="no_gap", untestable=problem.untestable)
    return _Search(problem, progress, seed).run()


class _Search:
    """Fits and derivatives so far."""

    def __init__(
        self, problem: Problem, progress: Callable[[str, int], None] | None, seed: int
    ) -> None:
        self._problem = problem
        self._layout = Layout.of(problem)
        self._evaluate = Evaluator(problem, progress)
        self._seed = seed
        self._rest: Floats
        """All unknowns without any effect, with the shapes that look best, shape (blocks,
        unknowns)."""
        self._fits: dict[Model, Fit] = {}
        self._libraries: dict[Model, Floats] = {}
        self._choices: dict[str, dict[float, Floats]] = {}
        """Derivatives by all unknowns without effects, for each effect with a choice and each value
        of that choice; arrays of shape (blocks, unknowns, m)."""
        self._split: Split
        self._comparison: decide.ModelComparison

    def run(self) -> Findings:
        """The whole search."""
        self._fit_null()
        self._comparison = decide.ModelComparison(
            layout=self._layout,
            split=self._split,
            cells=Cells.of(self._problem, self._split.is_fit),
            rng=np.random.default_rng(self._seed),
            size=decide.SIZE_RMS * self._problem.samples_per_residual**0.5,
            further_share=decide.FURTHER_SHARE * self._problem.simulator_disagreement,
        )
        if self._is_worth_fitting():
            self._fit_singles()
            for size in range(2, LARGEST + 1):
                if decide.may_gain(
                    self._comparison, self._fits[()], self._fits[self._best(size - 1)]
                ):
                    self._fit_larger(self._best(size - 1), size)
            self._refit_rivals()
        return conclude.findings(
            self._problem, self._comparison, self._evaluate, self._fits, self._library_quadratic
        )

    def _fit_null(self) -> None:
        """Fits the model without effects, splits the log and chooses the shapes of absent effects."""
        null, self._split = fit.fitted_null(self._problem, self._evaluate, self._layout)
        self._fits[()] = null
        self._rest = null.unknowns.copy()
        self._libraries[()] = self._slopes_of_starts(null)

    def _slopes_of_starts(self, null: Fit) -> Floats:
        """Derivatives by all unknowns, each candidate at its most promising shape, which is kept."""
        layout = self._layout
        blocks, m = null.residuals.shape
        library = np.zeros((blocks, len(layout.scale), m))
        library[:, null.columns] = null.jacobian
        tries = [
            (index, shape)
            for index, candidate in enumerate(layout.candidates)
            if not candidate.is_nuisance
            for shape in layout.starts(index)
        ]
        sets, owners = [], []
        for index, shape in tries:
            columns = layout.of_candidate(index)
            point = null.unknowns.copy()
            point[:, columns] = shape
            for column in columns[~layout.is_shape[columns]]:
                moved = point.copy()
                moved[:, column] += layout.first[column]
                sets.append(moved)
                owners.append(column)
        if not sets:
            return library
        change = self._evaluate("slopes", np.array(sets)) - null.residuals
        best = np.full((blocks, len(layout.scale)), -1.0)
        seen = self._split.is_fit
        for moved, column, r in zip(sets, owners, change, strict=True):
            slope = r / layout.first[column]
            candidate = layout.candidates[layout.candidate[column]]
            for choice in layout.choices([candidate.effect]):
                if layout.candidate[choice] == layout.candidate[column]:
                    at = self._choices.setdefault(candidate.effect, {})
                    at.setdefault(moved[0, choice], np.zeros_like(library))[:, column] = slope
            power = np.einsum("bm,bm->b", slope[:, seen], slope[:, seen])
            cross = np.einsum("bm,bm->b", slope[:, seen], null.residuals[:, seen])
            promise = np.where(power > 0.0, cross**2 / np.maximum(power, 1e-300), 0.0)
            for block in np.flatnonzero(promise > best[:, column]):
                best[block, column] = promise[block]
                library[block, column] = slope[block]
                shapes = layout.of_candidate(int(layout.candidate[column]))
                shapes = shapes[layout.is_shape[shapes]]
                self._rest[block, shapes] = moved[block, shapes]
        return library

    def _is_worth_fitting(self) -> bool:
        """True where the quadratic promises a larger gain than chance from all effects together."""
        quadratic = self._library_quadratic(())
        null = quadratic.where(self._layout.nuisances)
        gain = 0.5 * (quadratic.fit_cost(null) - quadratic.fit_cost(np.ones_like(null)))
        return gain > decide.GAIN_NATS

    def _fit_singles(self) -> None:
        """Fits each effect alone, and the best ones again with fresh derivatives and other shapes."""
        null = self._fits[()]
        starts = [
            start for effect in self._layout.effects for start in self._starts((effect,), null)
        ]
        tried = fit.refine(
            self._evaluate, self._layout, self._split, starts, stage="single effects"
        )
        fits = fit.best_of_each(tried, self._split)
        self._keep(fits)
        best = sorted(fits, key=self._cost)[:REFITTED]
        self._refit([each.model for each in best], "single effects")
        self._restart(self._best(1), "single effects")
        self._fit_likely()

    def _fit_likely(self) -> None:
        """Fits the model that the problem itself sees, and its parts.

        From none of its effects slopes lead there.
        """
        likely, layout, null = self._problem.likely, self._layout, self._fits[()]
        if likely is None:
            return
        model = model_of(
            [effect for effect in layout.effects if likely[layout.of_effects([effect])].any()]
        )[:LARGEST]
        columns, own = layout.of_model(model), layout.of_effects(model)
        unknowns = null.unknowns.copy()
        unknowns[:, own] = np.clip(likely[own], layout.low[own], layout.high[own])
        self._fits[model] = fit.begun(
            self._evaluate, layout, model, columns, unknowns, "single effects"
        )
        self._refit([model], "single effects")
        while len(model) > 1:
            self._eliminate(model)
            parts = [model_of(set(model) - {effect}) for effect in model]
            model = min(parts, key=lambda part: self._cost(self._fits[part]))

    def _refit(self, models: list[Model], stage: str) -> None:
        """Renews derivatives of fits and continues them."""
        fresh = fit.renewed(
            self._evaluate, self._layout, [self._fits[model] for model in models], stage
        )
        self._keep(fit.refine(self._evaluate, self._layout, self._split, fresh, stage=stage))

    def _fit_larger(self, best_so_far: Model, size: int) -> None:
        """Fits models of up to `size` effects that the derivatives at the best model so far propose."""
        others = self._others(best_so_far, size - 1)
        for model in (best_so_far, *others):
            self._library(model)
            self._fit_union(best_so_far, model, size)
        proposed = self._propose(best_so_far, size)
        for other in others:
            proposed += self._propose(other, size)[: PROPOSED // 2]
        models = dict.fromkeys(model for model in proposed if model not in self._fits)
        starts = [
            start
            for model in models
            for part in self._parts(model)
            for start in self._starts(model, part)
        ]
        fits = fit.best_of_each(
            fit.refine(self._evaluate, self._layout, self._split, starts, stage=f"{size} effects"),
            self._split,
        )
        self._keep(fits)
        self._refit([each.model for each in sorted(fits, key=self._cost)[:2]], f"{size} effects")
        if any(len(model) == size for model in self._fits):
            if size == 2:
                self._restart(self._best(size), "2 effects")
            self._eliminate(self._best(size))

    def _fit_union(self, best_so_far: Model, other: Model, size: int) -> None:
        """Fits the union of two good models; where they imitate each other, both have far to go."""
        model = model_of([*best_so_far, *other])
        if len(model) != size or model in self._fits:
            return
        stage, parts = f"{size} effects", [self._fits[part] for part in (best_so_far, other)]
        fits = [start for part in parts for start in self._starts(model, part)]
        for patience in range(PATIENCE):
            if patience:
                fits = fit.renewed(self._evaluate, self._layout, fits, stage)
            fits = fit.refine(self._evaluate, self._layout, self._split, fits, stage=stage)
        (self._fits[model],) = fit.best_of_each(fits, self._split)

    def _refit_rivals(self) -> None:
        """Continues the best models that explain the gap, and renews their derivatives.

        The cost on held-out data follows from derivatives; old ones made one of two models that
        look alike 90 nats worse.
        """
        null, models = self._fits[()], list[Model]()
        for size in range(1, LARGEST + 1):
            explain = [
                each
                for each in self._of_size(size)
                if decide.explains(self._comparison, null, each)
            ]
            models += [each.model for each in explain[:RIVALS]]
        self._refit(models, "rivals")
        # what the descent corrected on its way is not what the derivatives are at its end
        rivals = [self._fits[model] for model in models]
        self._keep(fit.renewed(self._evaluate, self._layout, rivals, "rivals"))

    def _keep(self, fits: Iterable[Fit]) -> None:
        """Fits in place of the known ones of the same models."""
        self._fits |= {each.model: each for each in fits}

    def _restart(self, model: Model, stage: str) -> None:
        """Refits a model from all known shapes of its effects, if it leaves structure.

        A poorly fitting shape may still be a local minimum, in some blocks or in all.
        """
        if not self._comparison.is_gap(self._fits[model].residuals):
            return
        layout, here = self._layout, self._fits[model]
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
                at, fit.all_slopes(self._evaluate, layout, at, stage), strict=True
            ):
                jacobian = here.jacobian.copy()
                jacobian[:, np.isin(here.columns, columns)] = own
                starts.append(replace(here, unknowns=unknowns, residuals=r, jacobian=jacobian))
            tried = fit.refine(self._evaluate, layout, self._split, starts, stage=stage)
            self._keep(fit.best_of_each(tried, self._split))
            self._libraries.pop(model, None)
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

    def _eliminate(self, model: Model) -> None:
        """Refits the model without each of its effects, from its values: this may leave a poor minimum."""
        full = self._fits[model]
        parts = [model_of(set(model) - {effect}) for effect in model]
        points = []
        for part in parts:
            idle = self._layout.of_effects(set(model) - set(part))
            unknowns = full.unknowns.copy()
            unknowns[:, idle] = self._rest[:, idle]
            points.append(unknowns)
        residuals = self._evaluate("elimination", np.array(points))
        starts = []
        for part, unknowns, r in zip(parts, points, residuals, strict=True):
            columns = self._layout.of_model(part)
            jacobian = full.jacobian[:, np.isin(full.columns, columns)]
            starts.append(
                Fit(model=part, columns=columns, unknowns=unknowns, residuals=r, jacobian=jacobian)
            )
        tried = fit.refine(self._evaluate, self._layout, self._split, starts, stage="elimination")
        known = self._fits
        better = [
            each
            for each in tried
            if each.model not in known or self._cost(each) < self._cost(known[each.model])
        ]
        self._keep(better)
        for each in better:
            self._libraries.pop(each.model, None)
        self._refit([each.model for each in better], "elimination")

    def _propose(self, best_so_far: Model, size: int) -> list[Model]:
        """Models of `size` effects, and swaps in the best one so far, that fit best by its quadratic."""
        quadratic = self._library_quadratic(best_so_far)
        effects = self._layout.effects
        if size == 2:
            models = [model_of(pair) for pair in combinations(effects, 2)]
        else:
            rest = [effect for effect in effects if effect not in best_so_far]
            models = [model_of([*best_so_far, new]) for new in rest]
            models += [
                model_of([*kept, new])
                for kept in combinations(best_so_far, len(best_so_far) - 1)
                for new in rest
            ]
        costs = {
            model: quadratic.fit_cost(quadratic.where(self._layout.of_model(model)))
            for model in models
        }
        return sorted(costs, key=costs.__getitem__)[:PROPOSED]

    def _starts(self, model: Model, nearest: Fit) -> list[Fit]:
        """Starts of a fit, one for every value of a choice that the fit of fewer effects lacks.

        No slope leads from one value of a choice to another, and the better one alone may be the
        worse one beside another effect.
        """
        starts = [self._start(model, nearest)]
        for effect in sorted((set(model) - set(nearest.model)) & self._choices.keys()):
            starts = [
                self._chosen(start, effect, value, slopes)
                for start in starts
                for value, slopes in self._choices[effect].items()
            ]
        return starts

    def _chosen(self, start: Fit, effect: str, value: float, slopes: Floats) -> Fit:
        """A start with this value of a choice; blocks with another get the derivatives there."""
        choices, own = self._layout.choices([effect]), self._layout.of_effects([effect])
        other = np.flatnonzero(np.any(start.unknowns[:, choices] != value, axis=1))
        unknowns, jacobian = start.unknowns.copy(), start.jacobian.copy()
        unknowns[:, choices] = value
        jacobian[np.ix_(other, np.flatnonzero(np.isin(start.columns, own)))] = slopes[
            np.ix_(other, own)
        ]
        return replace(start, unknowns=unknowns, jacobian=jacobian)

    def _start(self, model: Model, nearest: Fit) -> Fit:
        """Start of a fit: the fit of fewer effects, with derivatives from the nearest library."""
        columns = self._layout.of_model(model)
        unknowns = nearest.unknowns.copy()
        new = self._layout.of_effects(set(model) - set(nearest.model))
        unknowns[:, new] = self._rest[:, new]
        known = nearest.model if nearest.model in self._libraries else ()
        library = self._libraries[known]
        jacobian = library[:, columns].copy()
        jacobian[:, np.isin(columns, nearest.columns)] = nearest.jacobian
        return Fit(
            model=model,
            columns=columns,
            unknowns=unknowns,
            residuals=nearest.residuals.copy(),
            jacobian=jacobian,
        )

    def _parts(self, model: Model) -> list[Fit]:
        """Fits of some of a model's effects to start from.

        The best one. For pairs with shapes also each effect alone: a shape that made up for the
        missing effect may be a poor minimum beside it.
        """
        parts = sorted(
            (each for each in self._fits.values() if set(each.model) < set(model)), key=self._cost
        )
        found = parts[:1]
        if len(model) == 2 and np.any(self._layout.is_shape[self._layout.of_effects(model)]):
            found += [self._fits[effect,] for effect in model]
        return list({each.model: each for each in found}.values())

    def _others(self, best_so_far: Model, size: int) -> list[Model]:
        """Further models from which larger ones are proposed: the second best, and for pairs the empty one.

        The best may imitate the whole truth while the second best is a part of it.
        """
        next_best = [each.model for each in self._of_size(size) if each.model != best_so_far][:1]
        return [(), *next_best] if size == 1 else next_best

    def _best(self, size: int) -> Model:
        """The best-fitting model of this many effects, or of fewer if there is none."""
        return self._of_size(max(len(model) for model in self._fits if len(model) <= size))[0].model

    def _of_size(self, size: int) -> list[Fit]:
        """Fits of this many effects, the best first."""
        return sorted(
            (each for each in self._fits.values() if len(each.model) == size), key=self._cost
        )

    def _cost(self, each: Fit) -> float:
        return self._comparison.cost(each.residuals)

    def _library(self, model: Model) -> Floats:
        """Derivatives by all unknowns at a fit, shape (blocks, unknowns, m); computed once."""
        if model not in self._libraries:
            here = self._fits[model]
            unknowns, layout = here.unknowns.copy(), self._layout
            idle = layout.of_effects(set(layout.effects) - set(model))
            unknowns[:, idle] = self._rest[:, idle]
            library = np.zeros((len(unknowns), len(layout.scale), here.residuals.shape[1]))
            moving = np.union1d(np.setdiff1d(idle, np.flatnonzero(layout.is_shape)), here.columns)
            library[:, moving] = fit.slopes(
                self._evaluate, layout, unknowns, here.residuals, moving, "slopes"
            )
            self._libraries[model] = library
            self._fits[model] = replace(here, jacobian=library[:, here.columns])
        return self._libraries[model]

    def _library_quadratic(self, model: Model) -> Quadratic:
        every = np.arange(len(self._layout.scale))
        here = self._fits[model]
        unknowns = np.where(np.isin(every, here.columns), here.unknowns, self._rest)
        return Quadratic.of(
            self._layout, self._split, every, unknowns, here.residuals, self._library(model)
        )
