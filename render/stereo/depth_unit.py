"""A camera sends depth in whole units."""

from dataclasses import dataclass, replace

from saltus.arrays import namespace
from saltus.effects.effect import parameter
from saltus.effects.signals import DepthImage
from saltus.render.single_image import SingleImageEffect

LARGEST = 65535  # of the 16 bits of a pixel; what is farther is sent as 0


@dataclass(frozen=True, kw_only=True)
class DepthUnit(SingleImageEffect[DepthImage], name="depth_unit"):
    """Rounds depth [m] to whole units; 0 is invalid,
    and so is what is farther than 16 bits can say.
    """

    # 1 mm (librealsense: default of the D400 family)
    unit: float = parameter(unit="m", null=0.0, low=0.0, high=0.1)

    def changed(self, signal: DepthImage) -> DepthImage:
        """Rounds."""
        xp = namespace(signal.depth)
        count = xp.round(signal.depth * (1.0 / self.unit))
        fits = count < LARGEST
        count *= self.unit
        return replace(signal, depth=xp.where(fits, count, xp.zeros_like(count[..., :1, :1])))
