"""What a search for missing effects works on: unknowns at which 0 is "no effect", and residuals in units of noise.

A problem belongs to one kind of sensor: the joints, the camera, the body, the IMU. It replays a run log through the
simulator with effects added and returns measured minus simulated, whitened: white noise of unit variance where the
model is right. The search (`saltus.real2sim.search.search`) knows nothing of robots; problems know nothing of
statistics.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from saltus.arrays import Floats, Indices


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
    starts: tuple[tuple[float, ...], ...]
    """Values from which fits start, in the order of `unknowns`; at least one."""
    is_nuisance: bool = False
    """Fitted with every model, the empty one too, and never reported, e.g. the rate of the drive's loop."""
    model_error: float = 0.02
    """Standard error, as a share of a parameter or of its distance from the null value, by which two right models of
    the effect disagree on it, e.g. a smooth and a sharp law of friction."""
    resolution: float = 0.0
    """The same for its first parameter in the parameter's unit, however small the effect: what two right simulations
    without any effect would disagree by."""
    faithful: float = 1.0
    """Share of its gap that a right model of the effect closes; less where chance decides, as when a drive hunts."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """One physical parameter, as `verdict.json` states it."""

    value: float
    unit: str


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
    simulation_doubt: float = 1.0
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
            residual is clipped to +-100.
        """

    @abstractmethod
    def physical(self, candidate: Candidate, values: Floats) -> dict[str, Estimate]:
        """Parameters in the schema's names and units, for the candidate's unknowns, shape (its unknowns,)."""

    def drivers(self) -> tuple[Driver, ...]:
        """What may drive residuals, besides columns of the log; values of shape (m,), NaN where it says nothing."""
        return ()
