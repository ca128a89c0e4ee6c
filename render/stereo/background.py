"""Behind all that is modelled there is something: a camera in a room does not look into nothing."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from saltus.arrays import namespace
from saltus.effects.effect import Effect, PerRobot, Site, parameter, per_image
from saltus.render.stereo.image import StereoImage


@dataclass(frozen=True, kw_only=True)
class Background(Effect[StereoImage]):
    """A wall at this distance, which faces the camera, where no ray hits anything nearer.

    At 6 m one pixel in 14 is lost to `WeakSignal`, and the noise is 0.3 m: "far" for the model, whose range is 3 m.
    What the right imager does not see is that of a scene without the wall: shadows before it are 1.2 px too wide.
    """

    name: ClassVar[str] = "background"
    site: ClassVar[Site] = "depth"

    # 6 m: a large room; within the 10 m that a D435i measures (D435i datasheet), twice the range of the model
    distance: PerRobot = parameter(unit="m", null=np.inf, low=0.1, high=1e3)

    def apply(self, signal: StereoImage, time_s: float, state: Any) -> tuple[StereoImage, Any]:
        """Puts the wall there."""
        del time_s
        if self.is_null():
            return signal, state
        xp = namespace(signal.disparity)
        wall = signal.optics.disparity_at_1m / per_image(self.distance, signal.disparity, xp)
        nearest = xp.zeros_like(signal.disparity[..., :1, :1]) + wall
        seen = xp.maximum(signal.disparity, nearest)
        return replace(signal, disparity=seen, truth=xp.maximum(signal.truth, nearest)), state
