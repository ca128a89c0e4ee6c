"""What a search hands on: effects found for one kind of sensor, how sure they are, and what else was considered."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.real2sim.problem.problem import Estimate

ProblemRuling = Literal["named", "set", "unexplained", "no_gap"]


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A physical parameter with the interval that holds it in 90 % of logs."""

    value: float
    ci90: tuple[float, float]
    unit: str


@dataclass(frozen=True, kw_only=True)
class FoundEffect:
    """An effect with the values it has at some places."""

    name: str
    where: str | tuple[str, ...]
    """"all", the names of places, or, where the problem has one place only, its name."""
    params: dict[str, Interval]
    curve: tuple[tuple[float, float], ...] = ()
    """Of a saturation: commanded and delivered torque at these places [Nm]."""


@dataclass(frozen=True, kw_only=True)
class RankedModel:
    """A set of effects that was fitted, and what it is worth on segments held out from its fit."""

    effects: tuple[str, ...]
    gain: float
    """Drop of the held-out cost against the model without effects [nats]."""
    gain_ci90: tuple[float, float]
    closed: float
    """Share of the closable gap, held out."""


@dataclass(frozen=True, kw_only=True)
class SignalGap:
    """Mean squared whitened residual of one signal on the test segments."""

    signal: str
    residuals: int
    before: float
    after: float
    floor: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Confusion:
    """Cosines between what the effects do to the residuals of these data, with nuisances projected out."""

    effects: tuple[str, ...]
    cosine: Floats
    """Shape (effects, effects), 0 to 1."""

    def between(self, a: str, b: str) -> float:
        """The cosine of two effects; 0 where one leaves no trace."""
        if a not in self.effects or b not in self.effects:
            return 0.0
        return float(self.cosine[self.effects.index(a), self.effects.index(b)])


@dataclass(frozen=True, kw_only=True, eq=False)
class Residuals:
    """What two models leave of a log, whitened; shapes as in `saltus.real2sim.problem.problem`."""

    before: Floats
    """By the model without effects, shape (blocks, m)."""
    after: Floats
    """By the model that was chosen, with the values as they are reported, shape (blocks, m)."""
    unknowns: Floats
    """Of that model, with the values as they are reported, shape (blocks, unknowns)."""
    effects: tuple[str, ...]
    """Of that model; it is chosen where it explains too little to be named, too."""
    is_test: NDArray[np.bool_]
    """Shape (m,): rows that no fit has seen."""


@dataclass(frozen=True, kw_only=True)
class Baselines:
    """What simpler ways would have named, for comparison only."""

    threshold: tuple[str, ...]
    """All effects whose estimate in one joint fit differs from 0 by more than three of its standard errors."""
    lowest_training_error: tuple[str, ...]
    """The one effect that fits best, with no held-out data and no threshold."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Findings:
    """The result of `saltus.real2sim.search.search` for one kind of sensor."""

    problem: str
    verdict: ProblemRuling
    effects: tuple[FoundEffect, ...] = ()
    """Those that nothing else explains as well."""
    sets: tuple[tuple[str, ...], ...] = ()
    """Effects that these data cannot tell apart, at most three each."""
    rivals: tuple[FoundEffect, ...] = ()
    """The fitted values of all effects in sets."""
    ranking: tuple[RankedModel, ...] = ()
    """Best first."""
    confusion: Confusion = field(default_factory=lambda: Confusion(effects=(), cosine=np.zeros((0, 0))))
    gaps: tuple[SignalGap, ...] = ()
    residuals: Residuals | None = None
    """None where nothing was fitted."""
    remainder: float = 0.0
    """RMS of what the best model leaves above the noise, in the segment and signal that show it best [sigma]."""
    minimum_detectable: dict[str, Estimate] = field(default_factory=dict)
    untestable: dict[str, str] = field(default_factory=dict)
    baselines: Baselines = field(default_factory=lambda: Baselines(threshold=(), lowest_training_error=()))
    evaluations: int = 0
    """Sets of unknowns that were simulated."""
