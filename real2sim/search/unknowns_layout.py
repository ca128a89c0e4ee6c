"""Columns of the vector of unknowns, and models as sets of effects."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.problem import Candidate, Problem

STEP = 0.25
"""Step of finite differences as a fraction of an unknown's scale: small against what matters, large
against rounding."""

ModelEffects = tuple[str, ...]
"""Effects of a model, sorted; () is the model without effects."""


@dataclass(frozen=True, kw_only=True, eq=False)
class UnknownsLayout:
    """Columns of the vector of unknowns of a problem."""

    candidates: tuple[Candidate, ...]
    candidate: Indices
    """Index of the candidate of each unknown, shape (unknowns,)."""
    is_shape: Indices
    low: Floats
    high: Floats
    scale: Floats
    first: Floats
    """Step of finite differences from 0, shape (unknowns,): half of the smallest start. Some
    effects show nothing below the time step of a simulation, so that a fraction of the scale would
    be too small."""

    @classmethod
    def of(cls, problem: Problem) -> "UnknownsLayout":
        """The layout of a problem."""
        unknowns = [unknown for candidate in problem.candidates for unknown in candidate.unknowns]
        return cls(
            candidates=problem.candidates,
            candidate=np.repeat(
                np.arange(len(problem.candidates)), [len(c.unknowns) for c in problem.candidates]
            ),
            is_shape=np.array([unknown.is_shape for unknown in unknowns], dtype=bool),
            low=np.array([unknown.low for unknown in unknowns]),
            high=np.array([unknown.high for unknown in unknowns]),
            scale=np.array([unknown.scale for unknown in unknowns]),
            first=np.array(
                [_first_step(c, i) for c in problem.candidates for i in range(len(c.unknowns))]
            ),
        )

    @property
    def effects(self) -> ModelEffects:
        """Names of the effects without nuisances, in the order of the candidates."""
        return tuple(dict.fromkeys(c.effect for c in self.candidates if not c.is_nuisance))

    @property
    def nuisances(self) -> Indices:
        """Columns that every model fits."""
        return np.flatnonzero([self.candidates[i].is_nuisance for i in self.candidate])

    def of_candidate(self, index: int) -> Indices:
        """Columns of one candidate."""
        return np.flatnonzero(self.candidate == index)

    def of_effects(self, effects: Iterable[str]) -> Indices:
        """Columns of effects, without nuisances."""
        names = set(effects)
        return np.flatnonzero([self.candidates[i].effect in names for i in self.candidate])

    def choices(self, effects: Iterable[str]) -> Indices:
        """Columns of the choices of effects."""
        unknowns = [unknown for candidate in self.candidates for unknown in candidate.unknowns]
        return np.array(
            [i for i in self.of_effects(effects) if unknowns[i].is_choice], dtype=np.int64
        )

    def of_model(self, model: ModelEffects) -> Indices:
        """Columns that a model fits: those of its effects and of the nuisances,
        in ascending order.
        """
        return np.sort(np.concatenate([self.of_effects(model), self.nuisances]))

    def starts(self, index: int) -> list[Floats]:
        """Different shapes from which fits of a candidate start;
        0 for unknowns that are not shapes.
        """
        shapes = [
            np.where(self.is_shape[self.of_candidate(index)], s, 0.0)
            for s in self.candidates[index].starts
        ]
        return list({tuple(shape): shape for shape in shapes}.values())


def _first_step(candidate: Candidate, index: int) -> float:
    sizes = [abs(start[index]) for start in candidate.starts if start[index] != 0.0]
    if candidate.is_nuisance or candidate.unknowns[index].is_shape or not sizes:
        return STEP * candidate.unknowns[index].scale
    return 0.5 * min(sizes)


def with_effects(effects: Iterable[str]) -> ModelEffects:
    """The model with these effects."""
    return tuple(sorted(set(effects)))
