"""Fits and derivatives that a search has so far, and the starts of further fits that they give."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import combinations

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.search import model_fit
from saltus.real2sim.search.model_fit import ModelFit, ProblemEvaluator
from saltus.real2sim.search.quadratic import QuadraticCost
from saltus.real2sim.search.residual_split import ResidualSplit
from saltus.real2sim.search.unknowns_layout import ModelEffects, UnknownsLayout, with_effects

PROPOSED = 6
"""Number of larger models that are fitted after each set of derivatives."""


class KnownFits:
    """Fits that the search has made so far: the best of each model, and derivatives by all unknowns
    at some of them.

    Args:
        null: Fit of the model without effects. Derivatives are computed there.
        cost: Sum of squares of the residuals that fits see.
    """

    def __init__(
        self,
        layout: UnknownsLayout,
        split: ResidualSplit,
        evaluate: ProblemEvaluator,
        null: ModelFit,
        cost: Callable[[Floats], float],
    ) -> None:
        self._layout, self._split, self._evaluate = layout, split, evaluate
        self._cost_of = cost
        self.fits: dict[ModelEffects, ModelFit] = {(): null}
        self.rest = null.unknowns.copy()
        """All unknowns without any effect, with the shapes that look best, shape (blocks,
        unknowns)."""
        self._choices: dict[str, dict[float, Floats]] = {}
        """Derivatives by all unknowns without effects, for each effect with a choice and each value
        of that choice; arrays of shape (blocks, unknowns, m)."""
        self._libraries: dict[ModelEffects, Floats] = {(): self._slopes_of_starts(null)}

    def best(self, size: int) -> ModelEffects:
        """The best-fitting model of this many effects, or of fewer if there is none."""
        return self.of_size(max(len(model) for model in self.fits if len(model) <= size))[0].model

    def of_size(self, size: int) -> list[ModelFit]:
        """Fits of this many effects, the best first."""
        return sorted(
            (each for each in self.fits.values() if len(each.model) == size), key=self.cost
        )

    def proposed(self, best_so_far: ModelEffects, size: int) -> list[ModelEffects]:
        """Models of `size` effects, and swaps in the best one so far,
        that fit best by its quadratic.
        """
        quadratic = self.quadratic(best_so_far)
        effects = self._layout.effects
        if size == 2:
            models = [with_effects(pair) for pair in combinations(effects, 2)]
        else:
            rest = [effect for effect in effects if effect not in best_so_far]
            models = [with_effects([*best_so_far, new]) for new in rest]
            models += [
                with_effects([*kept, new])
                for kept in combinations(best_so_far, len(best_so_far) - 1)
                for new in rest
            ]
        costs = {
            model: quadratic.fit_cost(quadratic.where(self._layout.of_model(model)))
            for model in models
        }
        return sorted(costs, key=costs.__getitem__)[:PROPOSED]

    def others(self, best_so_far: ModelEffects, size: int) -> list[ModelEffects]:
        """Further models from which larger ones are proposed:
        the second best, and for pairs the empty one.

        The best may imitate the whole truth while the second best is a part of it.
        """
        next_best = [each.model for each in self.of_size(size) if each.model != best_so_far][:1]
        return [(), *next_best] if size == 1 else next_best

    def cost(self, each: ModelFit) -> float:
        """Sum of squares of the residuals that fits see."""
        return self._cost_of(each.residuals)

    def keep(self, fits: Iterable[ModelFit]) -> None:
        """Fits in place of the known ones of the same models."""
        self.fits |= {each.model: each for each in fits}

    def starts(self, model: ModelEffects, nearest: ModelFit) -> list[ModelFit]:
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

    def _start(self, model: ModelEffects, nearest: ModelFit) -> ModelFit:
        """Start of a fit: the fit of fewer effects, with derivatives from the nearest library."""
        columns = self._layout.of_model(model)
        unknowns = nearest.unknowns.copy()
        new = self._layout.of_effects(set(model) - set(nearest.model))
        unknowns[:, new] = self.rest[:, new]
        known = nearest.model if nearest.model in self._libraries else ()
        library = self._libraries[known]
        jacobian = library[:, columns].copy()
        jacobian[:, np.isin(columns, nearest.columns)] = nearest.jacobian
        return ModelFit(
            model=model,
            columns=columns,
            unknowns=unknowns,
            residuals=nearest.residuals.copy(),
            jacobian=jacobian,
        )

    def _chosen(self, start: ModelFit, effect: str, value: float, slopes: Floats) -> ModelFit:
        """A start with this value of a choice; blocks with another get the derivatives there."""
        choices, own = self._layout.choices([effect]), self._layout.of_effects([effect])
        other = np.flatnonzero(np.any(start.unknowns[:, choices] != value, axis=1))
        unknowns, jacobian = start.unknowns.copy(), start.jacobian.copy()
        unknowns[:, choices] = value
        jacobian[np.ix_(other, np.flatnonzero(np.isin(start.columns, own)))] = slopes[
            np.ix_(other, own)
        ]
        return replace(start, unknowns=unknowns, jacobian=jacobian)

    def parts(self, model: ModelEffects) -> list[ModelFit]:
        """Fits of some of a model's effects to start from.

        The best one. For pairs with shapes also each effect alone: a shape that made up for the
        missing effect may be a poor minimum beside it.
        """
        parts = sorted(
            (each for each in self.fits.values() if set(each.model) < set(model)), key=self.cost
        )
        found = parts[:1]
        if len(model) == 2 and np.any(self._layout.is_shape[self._layout.of_effects(model)]):
            found += [self.fits[effect,] for effect in model]
        return list({each.model: each for each in found}.values())

    def forget(self, model: ModelEffects) -> None:
        """Derivatives at a fit that has moved."""
        self._libraries.pop(model, None)

    def library(self, model: ModelEffects) -> Floats:
        """Derivatives by all unknowns at a fit, shape (blocks, unknowns, m); computed once."""
        if model not in self._libraries:
            here = self.fits[model]
            unknowns, layout = here.unknowns.copy(), self._layout
            idle = layout.of_effects(set(layout.effects) - set(model))
            unknowns[:, idle] = self.rest[:, idle]
            library = np.zeros((len(unknowns), len(layout.scale), here.residuals.shape[1]))
            moving = np.union1d(np.setdiff1d(idle, np.flatnonzero(layout.is_shape)), here.columns)
            library[:, moving] = model_fit.slopes(
                self._evaluate, layout, unknowns, here.residuals, moving, "slopes"
            )
            self._libraries[model] = library
            self.fits[model] = replace(here, jacobian=library[:, here.columns])
        return self._libraries[model]

    def quadratic(self, model: ModelEffects) -> QuadraticCost:
        """The quadratic by all unknowns around a fit."""
        every = np.arange(len(self._layout.scale))
        here = self.fits[model]
        unknowns = np.where(np.isin(every, here.columns), here.unknowns, self.rest)
        return QuadraticCost.of(
            self._layout, self._split, every, unknowns, here.residuals, self.library(model)
        )

    def _slopes_of_starts(self, null: ModelFit) -> Floats:
        """Derivatives by all unknowns, each candidate at its most promising shape,
        which is kept.
        """
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
                self.rest[block, shapes] = moved[block, shapes]
        return library
