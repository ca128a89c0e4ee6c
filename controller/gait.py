"""The bounding gait: four contact modes driven by one phase.

In cycles since the start, modulo 1: front legs stand in [0.95, 1) and [0, 0.35), flight, rear legs
stand in [0.40, 0.80), flight. A leg that has had no stance yet counts as standing, so a robot that
starts on the ground begins with all four feet on it. Source: paper ("bounding gait with 4 contact
modes"), original (offsets and ratio).
"""

from dataclasses import dataclass

from saltus.arrays import Array, Constant, Counts, LegFlags, PerLeg, Scalars, namespace
from saltus.footholds import SWING_RATIO

OFFSET = Constant([0.05, 0.05, -0.40, -0.40])
"""Phase of each leg at the start [cycles]; original."""
STANCE_RATIO = 1.0 - SWING_RATIO
TRUSTED_SHARE = 0.5
"""Middle share of the stance in which a foot is taken to be on the ground; original."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GaitSignal:
    """Values of the gait's schedule at a tick: which legs stand or swing, and how far they are."""

    contact: LegFlags
    """Leg is to stand, bool, shape (..., 4)."""
    progress: PerLeg
    """Progress of the present stance or swing, [0, 1), shape (..., 4); 0 before the first
    stance."""
    trusted: LegFlags
    """Leg is in the middle of its stance, or has not moved yet, bool, shape (..., 4)."""
    cycle: Counts
    """Number of completed cycles (whole number as float), shape (...)."""
    stance_duration: Scalars
    """[s], shape (...)."""


def standing_gait(batch: tuple[int, ...], like: Array) -> GaitSignal:
    """The schedule of robots that have not begun: all feet on the ground.

    Arrays of the kind of `like`.
    """
    xp = namespace(like)
    zero = xp.zeros((*batch, 4), dtype=like.dtype, device=like.device)
    return GaitSignal(
        contact=zero == 0.0,
        progress=zero,
        trusted=zero == 0.0,
        cycle=zero[..., 0],
        stance_duration=zero[..., 0],
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class GaitState:
    """State of the gait's clock between ticks."""

    phase: Scalars
    """Cycles since the start, shape (...)."""

    def advanced(self, frequency: Scalars, dt_s: float) -> "GaitState":
        """The state one tick later, with the stepping frequency [Hz], shape (...)."""
        return GaitState(phase=self.phase + frequency * dt_s)

    def read(self, frequency: Scalars) -> GaitSignal:
        """The schedule at the present phase."""
        xp = namespace(self.phase)
        leg_phase = self.phase[..., None] + OFFSET.like(self.phase)
        fraction = leg_phase - xp.floor(leg_phase)
        waiting = leg_phase < 0.0
        stance = fraction < STANCE_RATIO
        contact = stance | waiting
        in_stance = fraction * (1.0 / STANCE_RATIO)
        in_swing = (fraction - STANCE_RATIO) * (1.0 / SWING_RATIO)
        progress = xp.where(stance, in_stance, xp.where(waiting, xp.zeros_like(fraction), in_swing))
        untrusted = 0.5 * (1.0 - TRUSTED_SHARE)
        middle = stance & (in_stance >= untrusted) & (in_stance <= 1.0 - untrusted)
        return GaitSignal(
            contact=contact,
            progress=progress,
            trusted=middle | waiting,
            cycle=xp.floor(self.phase),
            stance_duration=STANCE_RATIO / frequency,
        )
