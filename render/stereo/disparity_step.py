"""A matcher knows disparities in steps."""

from dataclasses import dataclass, replace
from typing import ClassVar

from saltus.arrays import namespace
from saltus.effects.effect import Effect, Site, parameter
from saltus.render.stereo.image import StereoImage


@dataclass(frozen=True, kw_only=True)
class DisparityStep(Effect[StereoImage]):
    """Rounds disparities to whole multiples of `step`: steps of z^2 step / (f B) in depth."""

    name: ClassVar[str] = "disparity_step"
    site: ClassVar[Site] = "depth"

    # 1/32 px: five fractional bits (D4 vision processor)
    step: float = parameter(unit="px", null=0.0, low=0.0, high=2.0)

    def apply(self, signal: StereoImage, time_s: float, state: None) -> tuple[StereoImage, None]:
        """Rounds."""
        del time_s, state
        if self.step == 0.0:
            return signal, None
        xp = namespace(signal.disparity)
        return replace(signal, disparity=xp.round(signal.disparity * (1.0 / self.step)) * self.step), None
