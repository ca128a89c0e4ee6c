"""A camera takes an image now and then; between exposures the last one stays."""

from dataclasses import dataclass
from typing import Any

from saltus.arrays import namespace
from saltus.effects.effect import Effect, parameter
from saltus.effects.signals import DepthImage, chosen, nothing_yet

ROUNDING_S = 1e-9  # times that are meant to be equal may differ by rounding
Memory = tuple[Any, DepthImage] | None
"""When each camera took its last image [s], shape (...), and these images."""


@dataclass(frozen=True, kw_only=True)
class SampleAndHold(Effect[DepthImage], name="sample_and_hold", site="depth"):
    """A new image every `period`, at the first sample at or after its time; each camera begins with its first one.

    20 ms in the original's training.
    """

    period: float = parameter(unit="s", null=0.0, low=0.0, high=1.0)

    def apply(self, signal: DepthImage, time_s: float, state: Memory) -> tuple[DepthImage, Memory]:
        """Returns the new image, or the one that is held."""
        xp = namespace(signal.time_s)
        taken_s, held = (xp.zeros_like(signal.time_s), nothing_yet(signal)) if state is None else state
        due = ~xp.isfinite(held.time_s) | (time_s >= taken_s + self.period - ROUNDING_S)
        image = chosen(due, signal, held)
        return image, (xp.where(due, time_s, taken_s), image)
