"""A matcher knows disparities in steps."""

from dataclasses import dataclass, replace

from saltus.arrays import namespace
from saltus.effects.effect import parameter
from saltus.render.single_image import SingleImageEffect
from saltus.render.stereo.image import StereoImage


@dataclass(frozen=True, kw_only=True)
class DisparityStep(SingleImageEffect[StereoImage], name="disparity_step"):
    """Rounds disparities to whole multiples of `step`: steps of z^2 step / (f B) in depth."""

    # 1/32 px: five fractional bits (D4 vision processor)
    step: float = parameter(unit="px", null=0.0, low=0.0, high=2.0)

    def changed(self, signal: StereoImage) -> StereoImage:
        """Rounds."""
        xp = namespace(signal.disparity)
        return replace(signal, disparity=xp.round(signal.disparity * (1.0 / self.step)) * self.step)
