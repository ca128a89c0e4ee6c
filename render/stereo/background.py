"""Behind all that is modelled there is something: a camera in a room does not look into nothing."""

from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import namespace
from saltus.effects.effect import PerRobot, parameter, per_image
from saltus.render.single_image import SingleImageEffect
from saltus.render.stereo.image import StereoImage


@dataclass(frozen=True, kw_only=True)
class Background(SingleImageEffect[StereoImage], name="background"):
    """A wall at this distance, which faces the camera, where no ray hits anything nearer.

    At 6 m one pixel in 14 is lost to `WeakSignal`, and the noise is 0.3 m: "far" for the model,
    whose range is 3 m. What the right imager does not see is that of a scene without the wall:
    shadows before it are 1.2 px too wide.
    """

    # 6 m: a large room; within the 10 m that a D435i measures (D435i datasheet), twice the range of
    # the model
    distance: PerRobot = parameter(unit="m", null=np.inf, low=0.1, high=1e3)

    def changed(self, signal: StereoImage) -> StereoImage:
        """Puts the wall there."""
        xp = namespace(signal.disparity)
        wall = signal.optics.disparity_at_1m / per_image(self.distance, signal.disparity, xp)
        nearest = xp.zeros_like(signal.disparity[..., :1, :1]) + wall
        seen = xp.maximum(signal.disparity, nearest)
        return replace(signal, disparity=seen, truth=xp.maximum(signal.truth, nearest))
