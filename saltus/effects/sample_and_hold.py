"""A camera takes an image now and then; between exposures the last one stays."""

from dataclasses import dataclass

from saltus.effects.effect import Effect, parameter
from saltus.effects.signals import DepthImage, chosen, nothing_yet

ROUNDING_S = 1e-9  # times that are meant to be equal may differ by rounding


@dataclass(frozen=True, kw_only=True)
class SampleAndHold(Effect[DepthImage], name="sample_and_hold", site="depth"):
    """The next image is the first that was exposed `period` or more after the last one.

    20 ms in the original's training.
    """

    period: float = parameter(unit="s", null=0.0, low=0.0, high=1.0)

    def apply(self, signal: DepthImage, time_s: float, state: DepthImage | None) -> tuple[DepthImage, DepthImage]:
        """Returns the new image, or the one that is held; so is the state."""
        del time_s
        held = nothing_yet(signal) if state is None else state
        image = chosen(signal.time_s >= held.time_s + self.period - ROUNDING_S, signal, held)
        return image, image
