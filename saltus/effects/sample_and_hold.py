"""A camera takes an image now and then; between exposures the last one stays."""

from dataclasses import dataclass

from saltus.effects.effect import Effect, parameter
from saltus.effects.signals import DepthImage

ROUNDING_S = 1e-9  # times that are meant to be equal may differ by rounding
Memory = tuple[float, DepthImage] | None
"""When the camera took its last image, and that image."""


@dataclass(frozen=True, kw_only=True)
class SampleAndHold(Effect[DepthImage], name="sample_and_hold", site="depth"):
    """A new image every `period`, at the first sample at or after its time; all cameras of a batch expose together.

    20 ms in the original's training.
    """

    period: float = parameter(unit="s", null=0.0, low=0.0, high=1.0)

    def apply(self, signal: DepthImage, time_s: float, state: Memory) -> tuple[DepthImage, Memory]:
        """Returns the new image, or the one that is held."""
        if state is not None and time_s < state[0] + self.period - ROUNDING_S:
            return state[1], state
        return signal, (time_s, signal)
