"""Findings of a search: effects of one kind of sensor, their intervals, and the alternatives."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.real2sim.problem.problem import ParameterEstimate

ProblemRuling = Literal["named", "set", "unexplained", "no_gap"]


@dataclass(frozen=True, kw_only=True)
class ParameterInterval:
    """A physical parameter with the interval that contains the truth in 90 % of logs."""

    value: float
    ci90: tuple[float, float]
    unit: str


@dataclass(frozen=True, kw_only=True)
class FoundEffect:
    """An effect that the search found in a log, with its values for all joints or for some."""

    name: str
    where: str | tuple[str, ...]
    """"all", names of places, or one name if the problem has one place only."""
    params: dict[str, ParameterInterval]
    curve: tuple[tuple[float, float], ...] = ()
    """Curve of a saturation: commanded and delivered torque at these places [Nm]."""


@dataclass(frozen=True, kw_only=True)
class RankedModel:
    """A fitted set of effects with its gain on held-out segments."""

    effects: tuple[str, ...]
    gain: float
    """Held-out gain over the model without effects [nats]."""
    gain_ci90: tuple[float, float]
    closed: float
    """Share of the closable gap that is closed, on held-out data."""


@dataclass(frozen=True, kw_only=True)
class SignalGap:
    """Mean squared whitened residual of one signal on the test segments."""

    signal: str
    residuals: int
    before: float
    after: float
    floor: float


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectConfusion:
    """Cosines between the changes that effects make in the residuals,
    with nuisances projected out.
    """

    effects: tuple[str, ...]
    cosine: Floats
    """Shape (effects, effects), 0 to 1."""

    def between(self, a: str, b: str) -> float:
        """Cosine of two effects; 0 if one leaves no trace."""
        if a not in self.effects or b not in self.effects:
            return 0.0
        return float(self.cosine[self.effects.index(a), self.effects.index(b)])


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelResiduals:
    """Whitened residuals of two models; shapes as in `saltus.real2sim.problem.problem`."""

    before: Floats
    """Residuals of the model without effects [sigma], shape (blocks, m)."""
    after: Floats
    """Residuals of the chosen model with the stated values [sigma], shape (blocks, m)."""
    unknowns: Floats
    """Unknowns of the chosen model with the stated values, shape (blocks, unknowns)."""
    effects: tuple[str, ...]
    """Effects of the chosen model, also if it explains too little to be named."""
    is_test: NDArray[np.bool_]
    """Rows that no fit has seen, shape (m,)."""


@dataclass(frozen=True, kw_only=True)
class SimplerMethods:
    """Effects that simpler methods would have named, for the benchmark."""

    threshold: tuple[str, ...]
    """All effects whose estimate in one common fit differs from 0 by more than three standard
    errors."""
    lowest_training_error: tuple[str, ...]
    """The one effect that fits best, without held-out data and thresholds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchFindings:
    """The result of `saltus.real2sim.search.search` for one kind of sensor."""

    problem: str
    verdict: ProblemRuling
    effects: tuple[FoundEffect, ...] = ()
    """Effects without equally good alternatives."""
    sets: tuple[tuple[str, ...], ...] = ()
    """Effects that the log cannot tell apart, at most three each."""
    rivals: tuple[FoundEffect, ...] = ()
    """Fitted values of all effects in sets."""
    nearest: tuple[FoundEffect, ...] = ()
    """Fitted values of the best model of an unexplained gap, which is too far off to be named."""
    ranking: tuple[RankedModel, ...] = ()
    """Best first."""
    confusion: EffectConfusion = field(
        default_factory=lambda: EffectConfusion(effects=(), cosine=np.zeros((0, 0)))
    )
    gaps: tuple[SignalGap, ...] = ()
    residuals: ModelResiduals | None = None
    """None where nothing was fitted."""
    remainder: float = 0.0
    """RMS beyond noise after the chosen model, in the segment and signal that show it best
    [sigma]."""
    minimum_detectable: dict[str, ParameterEstimate] = field(default_factory=dict)
    misfits: tuple[str, ...] = ()
    """Effects of the profile without which the simulator is much nearer to the log."""
    untestable: dict[str, str] = field(default_factory=dict)
    baselines: SimplerMethods = field(
        default_factory=lambda: SimplerMethods(threshold=(), lowest_training_error=())
    )
    evaluations: int = 0
    """Number of simulated sets of unknowns."""

    def __post_init__(self) -> None:
        if not self.gaps and (self.effects or self.sets or self.verdict in ("named", "set")):
            raise ValueError(f"the {self.problem} names effects that nothing was left to test by")
