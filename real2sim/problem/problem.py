"""A problem: residuals in units of noise as a function of unknowns,
each of which is 0 where its effect is absent.

A problem belongs to one kind of sensor: joints, camera, body or IMU. It replays a run log in the
simulator with effects added and returns measured minus simulated, whitened: if the model is right,
the residuals are white noise of unit variance. The search (`saltus.real2sim.search.search`) knows
nothing of robots, and problems know nothing of statistics.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import KW_ONLY, dataclass, fields
from typing import Any

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.effects.profile import EFFECTS, Profile

LARGEST_RESIDUAL = 100.0
"""Residuals are clipped to +- this value: a diverged simulation says no more than one that is far
off."""
LEAST_SIGMA = 6.0
"""Norm of the whitened change by an effect of usual size below which nobody could name it: its
estimate would have a standard error of a sixth of it, and a search over a dozen effects asks for
four."""


@dataclass(frozen=True, kw_only=True)
class LogSegment:
    """A named stretch of a run log, with its condition.

    Segments with one condition are repeats of a motion, or one motion at several amplitudes.
    """

    name: str
    start_s: float
    end_s: float
    condition: str


@dataclass(frozen=True)
class Unknown:
    """One number of an effect that the search estimates, in a coordinate in which residuals change
    smoothly.
    """

    name: str
    low: float
    high: float
    scale: float
    """A small change that matters, e.g. 1 ms of a delay. Finite differences step by a fraction of
    it."""
    _: KW_ONLY
    is_shape: bool = False
    """A shape matters only where another unknown of its candidate is not 0, e.g. the knee of a
    saturation."""
    stated: float | None = None
    """The only value other than 0 that a verdict can state; the values between help fits to get
    there."""
    is_choice: bool = False
    """True where only 0 and 1 are values: the better of the starts is taken, and nothing between is
    fitted."""
    is_told: bool = True
    """True where the effect has a parameter for it. What has none is fitted, and is 0 where a
    profile has the effect."""


@dataclass(frozen=True, kw_only=True)
class UnknownCoordinates:
    """How unknowns become the parameters of an effect, and back, where they are not the same."""

    parameters: Callable[[Floats], dict[str, float]]
    """Parameters of unknowns, shape (unknowns of the candidate,)."""
    unknowns: Callable[[Mapping[str, float]], Sequence[float]]
    """Unknowns of parameters by name."""

    @classmethod
    def less(cls, name: str, claimed: float) -> "UnknownCoordinates":
        """Coordinates with one unknown: the parameter less the value that a log claims."""
        return cls(
            parameters=lambda x: {name: claimed + float(x[0])},
            unknowns=lambda values: (values[name] - claimed,),
        )


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """An effect at one place, with its unknowns.

    It is absent where all unknowns that are not shapes are 0.
    """

    effect: str
    """Name in the schema of run logs, e.g. "coulomb_friction"; nuisances have their own names."""
    where: str
    """Place within a block: "hip", "thigh", "calf"; else "camera", "trunk", "feet" or "imu"."""
    unknowns: tuple[Unknown, ...]
    starts: tuple[tuple[float, ...], ...] = ()
    """Values from which fits start, in the order of `unknowns`; 0 where none are given."""
    is_nuisance: bool = False
    """True where it is fitted with every model, also the empty one, and never reported, e.g. the
    rate of the drive's loop."""
    model_error: float = 0.02
    """RMS of the difference between two correct models of the effect, e.g. a smooth and a sharp
    friction law, as a share of what the effect changes in the residuals."""
    resolution: float = 0.0
    """Difference of two correct simulations without effects, as a value of the first parameter in
    its unit."""
    closable_share: float = 1.0
    """Share of its gap that a correct model closes; below 1 where chance decides, as when a drive
    hunts."""
    leaves_chance: bool = False
    """True where what it leaves may be large, but is another at every repeat of a motion: packets
    that jitter."""
    least_closed: float = 0.0
    """Smallest part of `closable_share` that it closes where it alone is hidden; what it closes
    less of, and leaves more than correct simulations differ by, is none of it."""
    coordinates: UnknownCoordinates | None = None
    """None where the unknowns that are not `stated` are the parameters of the same names, less
    their null values (shapes: as they are)."""
    base: tuple[tuple[float, ...], ...] = ()
    """For each block, what the unknowns count from: those of a profile that the simulator has;
    empty where it is 0."""

    def __post_init__(self) -> None:
        if not self.starts:
            object.__setattr__(self, "starts", ((0.0,) * len(self.unknowns),))

    @property
    def absent(self) -> Floats:
        """Unknowns without the effect: 0, shapes as in the first start; shape (its unknowns,)."""
        return np.where([unknown.is_shape for unknown in self.unknowns], self.starts[0], 0.0)

    def parameters(self, unknowns: Floats, block: int = 0) -> dict[str, "ParameterEstimate"]:
        """Parameters in the schema's names and units, of unknowns of shape (its unknowns,);
        nuisances have no units.

        `block` matters only where a profile has other values in each.
        """
        if self.base:
            unknowns = unknowns + np.asarray(self.base[block])
        if self.coordinates is None:
            named = [
                (u, round(v) if u.is_choice else v)
                for u, v in zip(self.unknowns, unknowns, strict=True)
            ]
            found = {
                u.name: self._null(u) + value
                for u, value in named
                if u.stated is None and u.is_told
            }
        else:
            found = self.coordinates.parameters(unknowns)
        return {
            name: ParameterEstimate(value=float(value), unit=self._declared(name).get("unit", ""))
            for name, value in found.items()
        }

    def unknowns_of(self, parameters: Mapping[str, float]) -> Floats:
        """Unknowns within their bounds at which the effect has these parameters,
        or those that are nearest to them.
        """
        if self.coordinates is None:
            told = [u.stated is None and u.is_told for u in self.unknowns]
            found = [
                parameters[u.name] - self._null(u) if is_told else u.stated or 0.0
                for u, is_told in zip(self.unknowns, told, strict=True)
            ]
        else:
            found = list(self.coordinates.unknowns(parameters))
        return np.clip(found, [u.low for u in self.unknowns], [u.high for u in self.unknowns])

    def _null(self, unknown: Unknown) -> float:
        """Returns what it counts from.

        A shape counts from 0, as an effect may be absent by an infinite one.
        """
        return 0.0 if unknown.is_shape else float(self._declared(unknown.name).get("null", 0.0))

    def _declared(self, parameter: str) -> Mapping[str, Any]:
        """Declaration of a parameter by its effect; none for that of a nuisance."""
        known = fields(EFFECTS[self.effect]) if self.effect in EFFECTS else ()
        return next((field.metadata for field in known if field.name == parameter), {})


def parameter_unknown(parameter: str, scale: float, **more: Any) -> Callable[[str], Unknown]:
    """An unknown that is a parameter of its effect less its null value,
    between the values that the effect says.

    `more` are other fields of it; a shape counts from 0.
    """

    def of(effect: str) -> Unknown:
        declared = next(
            field.metadata for field in fields(EFFECTS[effect]) if field.name == parameter
        )
        null = 0.0 if more.get("is_shape") else float(declared.get("null", 0.0))
        low, high = EFFECTS[effect].sought(parameter)
        return Unknown(parameter, low - null, high - null, scale, **more)

    return of


def make_candidate(
    effect: str, *unknowns: Unknown | Callable[[str], Unknown], where: str, **more: Any
) -> Candidate:
    """A candidate in one line; `more` are other fields of it."""
    return Candidate(effect=effect, where=where, unknowns=unknowns_of(effect, unknowns), **more)


def unknowns_of(
    effect: str, unknowns: Sequence[Unknown | Callable[[str], Unknown]]
) -> tuple[Unknown, ...]:
    """Unknowns of an effect, with those that are `parameter_unknown` between its values."""
    return tuple(each if isinstance(each, Unknown) else each(effect) for each in unknowns)


@dataclass(frozen=True, kw_only=True)
class ParameterEstimate:
    """One physical parameter, as `verdict.json` states it."""

    value: float
    unit: str


@dataclass(frozen=True, kw_only=True, eq=False)
class ExplanatoryVariable:
    """A quantity that may explain a residual, at the times of the residual."""

    name: str
    """E.g. "tau"."""
    unit: str
    values: Floats
    """Shape (n,), with sign. For a regime: 1 within it, else 0."""
    is_regime: bool = False


class Problem(ABC):
    """Residuals of one kind of sensor as a function of the unknowns of all candidates.

    Attributes:
        name: "joints", "camera", "body" or "imu".
        blocks: Independent parts with the same candidates, e.g. the legs of a robot with a held
            base. No unknown of one block changes a residual of another.
        places: For each block, the name of a `where` in the verdict, e.g. {"calf": "FR_calf"};
            others go by their own.
        candidates: The same for every block. Their unknowns, in this order, make the vector of
            unknowns.
        segments: Segments of the log.
        segment: Index of the segment of each residual, shape (m,).
        signals: Names of the signals, e.g. ("q_hip", ..., "dq_calf").
        signal: Index of the signal of each residual, shape (m,).
        time_s: Time of each residual [s], shape (m,).
        untestable: Effects of this sensor that the log cannot show, and why, with numbers.
    """

    name: str
    blocks: tuple[str, ...]
    places: tuple[dict[str, str], ...]
    candidates: tuple[Candidate, ...]
    segments: tuple[LogSegment, ...]
    segment: Indices
    signals: tuple[str, ...]
    signal: Indices
    time_s: Floats
    untestable: dict[str, str]
    samples_per_residual: float = 1.0
    """Samples of the log that a residual averages. An effect stands out by the square root of it
    more than in one sample."""
    simulator_disagreement: float = 1.0
    """By how much two correct simulations of one effect differ, relative to simulations of drives
    and contacts."""

    held: tuple[str, ...] = ()
    """Effects that its simulator can have as a profile says them, beside fitted ones."""

    collinear: float = 0.95
    """Cosine from which two effects form a set although one of them explains more (schema of run
    logs)."""

    likely: Floats | None = None
    """Unknowns near which the problem itself sees that the truth lies, shape (unknowns,); nuisances
    do not count. None where slopes at the absence of all effects lead there."""

    @abstractmethod
    def residuals(self, unknowns: Floats) -> Floats:
        """Whitened residuals, measured minus simulated, for several sets of unknowns at once.

        Unknowns of all candidates have the shape (n, blocks, unknowns), residuals (n, blocks, m).
        They are finite: 0 for missing samples, clipped to +-`LARGEST_RESIDUAL` where a simulation
        diverges.
        """

    def explanatory_variables(self) -> tuple[ExplanatoryVariable, ...]:
        """Quantities besides columns of the log that may explain residuals:
        shape (m,), NaN where unknown.
        """
        return ()

    def leaner(self) -> "dict[str, Problem]":
        """Problems that each lack one effect of the profile with which the simulator starts, by its
        name.

        The unknowns stay.
        """
        return {}

    def holding(self, profile: Profile) -> "tuple[Problem, Profile]":
        """The problem on a simulator with what no unknown can represent of a profile,
        and the rest of the profile.

        Raises:
            ConfigError: an effect that the drives of the log's robot cannot have.
        """
        return self, profile

    def replayed_alike(self, effects: Sequence[str]) -> "Problem":
        """The problem in which every model is replayed as one with these effects;
        itself if it is so.
        """
        del effects
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all unknowns, "effect.unknown"."""
        return tuple(
            f"{candidate.effect}.{unknown.name}"
            for candidate in self.candidates
            for unknown in candidate.unknowns
        )

    @property
    def absent(self) -> Floats:
        """All unknowns without any effect, shape (unknowns,)."""
        return np.concatenate([candidate.absent for candidate in self.candidates])

    def one_by_one(self, changes: Mapping[str, float]) -> Floats:
        """Sets of unknowns of one block: first without effects,
        then with one changed unknown each, by its name.
        """
        sets = np.tile(self.absent, (1 + len(changes), 1))
        for one, (name, value) in zip(sets[1:], changes.items(), strict=True):
            one[self.names.index(name)] = value
        return sets

    def visibility(self, changes: Mapping[str, float]) -> dict[str, float]:
        """Norm of the whitened change that each changed unknown makes.

        For problems of one block.
        """
        residuals = self.residuals(self.one_by_one(changes)[:, None])[:, 0]
        return dict(
            zip(
                changes, np.linalg.norm(residuals[1:] - residuals[0], axis=-1).tolist(), strict=True
            )
        )


class WrappedProblem(Problem):
    """A problem with other unknowns than the one that it wraps, and with the same residuals."""

    def __init__(self, inner: Problem) -> None:
        self._inner = inner
        self.name, self.blocks, self.places, self.candidates = (
            inner.name,
            inner.blocks,
            inner.places,
            inner.candidates,
        )
        self.segments, self.segment = inner.segments, inner.segment
        self.signals, self.signal, self.time_s = inner.signals, inner.signal, inner.time_s
        self.samples_per_residual, self.simulator_disagreement = (
            inner.samples_per_residual,
            inner.simulator_disagreement,
        )
        self.untestable = inner.untestable

    def explanatory_variables(self) -> tuple[ExplanatoryVariable, ...]:
        """See `Problem`."""
        return self._inner.explanatory_variables()

    def replayed_alike(self, effects: Sequence[str]) -> Problem:
        """See `Problem`."""
        inner = self._inner.replayed_alike(effects)
        if inner is self._inner:
            return self
        problem = copy(self)
        problem._inner = inner
        return problem
