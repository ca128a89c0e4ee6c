"""A matcher searches a limited range of disparities, in an image that ends."""

from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import namespace
from saltus.effects.effect import PerRobot, parameter, per_image
from saltus.render.single_image import SingleImageEffect
from saltus.render.stereo.image import StereoImage


@dataclass(frozen=True, kw_only=True)
class SearchRange(SingleImageEffect[StereoImage], name="search_range"):
    """Pixels whose match would lie beyond the range of the search,
    or beyond the right image, are invalid.

    `maximum` makes the minimum depth f B / maximum. `margin` is by how much the right image goes on
    to the left of where the left image begins; at 0 there is an invalid band of f B / z pixels at
    the left of the sensor, below 0 it is wider, as where half a matching window does not fit.
    """

    # 126 px (Intel: MinZ = f B / 126, 0.17 m at 848x480)
    maximum: PerRobot = parameter(unit="px", null=np.inf, low=1.0, high=1e4)
    # 0 px (D435 datasheet: the band is f B / z wide; a recorded D435 at 640x480 shows 12 px more)
    margin: PerRobot = parameter(unit="px", null=np.inf, low=-200.0, high=1e4)

    def changed(self, signal: StereoImage) -> StereoImage:
        """Invalidates what cannot be found."""
        disparity, optics = signal.disparity, signal.optics
        xp = namespace(disparity)
        column = xp.arange(disparity.shape[-1], dtype=disparity.dtype, device=disparity.device)
        column = (column + 0.5) * optics.pitch_x + optics.first_column
        found = (disparity <= per_image(self.maximum, disparity, xp)) & (
            disparity <= column + per_image(self.margin, disparity, xp)
        )
        return replace(signal, valid=signal.valid & found)
