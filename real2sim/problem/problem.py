"""What a search for missing effects works on: unknowns at which 0 is "no effect", and residuals in units of noise.

A problem belongs to one kind of sensor: the joints, the camera, the body, the IMU. It replays a run log through the
simulator with effects added and returns measured minus simulated, whitened: white noise of unit variance where the
model is right. The search (`saltus.real2sim.search.search`) knows nothing of robots; problems know nothing of
statistics.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.effects.registry import EFFECTS

LARGEST_RESIDUAL = 100.0
"""Residuals are clipped to it: a simulation that falls over says no more than one that is far off."""


@dataclass(frozen=True, kw_only=True)
class Segment:
    """A stretch of a log, as `meta.json` names it; segments of one condition are repeats or one family."""

    name: str
    start_s: float
    end_s: float
    condition: str


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """One number to be found, in a coordinate that is smooth in the physics."""

    name: str
    low: float
    high: float
    scale: float
    """A small but telling change, e.g. 1 ms of a delay: finite differences step by a fraction of it."""
    is_shape: bool = False
    """Matters only where an unknown of its candidate that is no shape is not 0, e.g. the knee of a saturation."""
    stated: float | None = None
    """The one value other than absence that a verdict can state, where others are but a way for fits to come to it."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """An effect at one place, with its unknowns; the effect is absent where all that are no shapes are 0."""

    effect: str
    """Name in the schema of run logs, e.g. "coulomb_friction"; a nuisance has a name of its own."""
    where: str
    """Within a block: "hip", "thigh", "calf"; else "camera", "trunk", "feet" or "imu"."""
    unknowns: tuple[Unknown, ...]
    starts: tuple[tuple[float, ...], ...] = ()
    """Values from which fits start, in the order of `unknowns`; 0 where none are given."""
    is_nuisance: bool = False
    """Fitted with every model, the empty one too, and never reported, e.g. the rate of the drive's loop."""
    model_error: float = 0.02
    """Standard error, as a share of a parameter or of its distance from the null value, by which two right models of
    the effect disagree on it, e.g. a smooth and a sharp law of friction."""
    resolution: float = 0.0
    """The same for its first parameter in the parameter's unit, however small the effect: what two right simulations
    without any effect would disagree by."""
    closable_share: float = 1.0
    """Share of its gap that a right model of the effect closes; less where chance decides, as when a drive hunts."""

    def __post_init__(self) -> None:
        if not self.starts:
            object.__setattr__(self, "starts", ((0.0,) * len(self.unknowns),))

    @property
    def absent(self) -> Floats:
        """Unknowns without the effect: 0, and shapes as in the first start; shape (its unknowns,)."""
        return np.where([unknown.is_shape for unknown in self.unknowns], self.starts[0], 0.0)


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """One physical parameter, as `verdict.json` states it."""

    value: float
    unit: str


def estimates(effect: str, values: Mapping[str, float]) -> dict[str, Estimate]:
    """Parameters of an effect with the units that the effect declares; those of a nuisance have none."""
    declared = fields(EFFECTS[effect]) if effect in EFFECTS else ()
    units = {field.name: field.metadata.get("unit", "") for field in declared}
    return {name: Estimate(value=float(value), unit=units.get(name, "")) for name, value in values.items()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Driver:
    """Something that may drive a residual, at the residual's instants."""

    name: str
    """E.g. "tau"."""
    unit: str
    values: Floats
    """Shape (n,), with sign; for a regime 1 within it, else 0."""
    is_regime: bool = False


class Problem(ABC):
    """Residuals of one kind of sensor as a function of the unknowns of all candidates.

    Attributes:
        name: "joints", "camera", "body" or "imu".
        blocks: Independent parts with the same candidates, e.g. the legs of a robot whose base is held: no unknown of
            one block changes a residual of another.
        places: For each block the name of each `where`, as the verdict states it, e.g. {"calf": "FR_calf"}.
        candidates: The same for every block; their unknowns in this order make the vector of unknowns.
        segments: The log's.
        segment: To which of them a residual belongs, shape (m,).
        signals: Names of the signals, e.g. ("q_hip", ..., "dq_calf").
        signal: To which of them a residual belongs, shape (m,).
        time_s: When, shape (m,).
        untestable: Effects of this problem's sensors that this log cannot show, and why in words with numbers.
    """

    name: str
    blocks: tuple[str, ...]
    places: tuple[dict[str, str], ...]
    candidates: tuple[Candidate, ...]
    segments: tuple[Segment, ...]
    segment: Indices
    signals: tuple[str, ...]
    signal: Indices
    time_s: Floats
    untestable: dict[str, str]
    samples_per_residual: float = 1.0
    """Samples of the log that a residual averages: by its square root an effect stands out more than in one sample."""
    simulator_disagreement: float = 1.0
    """How much two right simulations of one effect differ, in units of what they do where robots have drives and
    contacts."""

    collinear: float = 0.95
    """Cosine from which two effects are a set although one of them explains more (schema of run logs)."""

    @abstractmethod
    def residuals(self, unknowns: Floats) -> Floats:
        """Whitened residuals, measured minus simulated, for several sets of unknowns at once.

        Args:
            unknowns: Shape (n, blocks, unknowns of all candidates).

        Returns:
            Shape (n, blocks, m); residuals of samples that are missing are 0. Finite: where a simulation diverges, the
            residual is clipped to +-`LARGEST_RESIDUAL`.
        """

    @abstractmethod
    def physical(self, candidate: Candidate, values: Floats) -> dict[str, Estimate]:
        """Parameters in the schema's names and units, for the candidate's unknowns, shape (its unknowns,)."""

    def drivers(self) -> tuple[Driver, ...]:
        """What may drive residuals, besides columns of the log; values of shape (m,), NaN where it says nothing."""
        return ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all unknowns, "effect.unknown"."""
        return tuple(
            f"{candidate.effect}.{unknown.name}" for candidate in self.candidates for unknown in candidate.unknowns
        )

    @property
    def absent(self) -> Floats:
        """All unknowns without any effect, shape (unknowns,)."""
        return np.concatenate([candidate.absent for candidate in self.candidates])

    def one_by_one(self, changes: Mapping[str, float]) -> Floats:
        """Sets of unknowns of the first block: without effects, then with one change of one unknown each.

        Args:
            changes: Values by the names of unknowns.

        Returns:
            Shape (1 + changes, unknowns).
        """
        sets = np.tile(self.absent, (1 + len(changes), 1))
        for one, (name, value) in zip(sets[1:], changes.items(), strict=True):
            one[self.names.index(name)] = value
        return sets

    def visibility(self, changes: Mapping[str, float]) -> dict[str, float]:
        """By how much each change moves all residuals of a problem of one block: norm of the whitened change."""
        residuals = self.residuals(self.one_by_one(changes)[:, None])[:, 0]
        return dict(zip(changes, np.linalg.norm(residuals[1:] - residuals[0], axis=-1).tolist(), strict=True))


class WrappedProblem(Problem):
    """A problem that changes the unknowns of another one and leaves its residuals as they are."""

    def __init__(self, inner: Problem) -> None:
        self._inner = inner
        self.name, self.blocks, self.places, self.candidates = inner.name, inner.blocks, inner.places, inner.candidates
        self.segments, self.segment = inner.segments, inner.segment
        self.signals, self.signal, self.time_s = inner.signals, inner.signal, inner.time_s
        self.samples_per_residual, self.simulator_disagreement = (
            inner.samples_per_residual,
            inner.simulator_disagreement,
        )
        self.untestable = inner.untestable

    def drivers(self) -> tuple[Driver, ...]:
        """See `Problem`."""
        return self._inner.drivers()
