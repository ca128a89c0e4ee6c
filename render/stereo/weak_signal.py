"""Surfaces that return too little of the projected pattern cannot be matched:
far ones and grazing ones.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from saltus.arrays import Array, Images, namespace
from saltus.effects.effect import PerRobot, parameter, per_image
from saltus.render.stereo.image import StereoImage
from saltus.render.stereo.random_effect import RandomStereoEffect


@dataclass(frozen=True, kw_only=True)
class WeakSignal(RandomStereoEffect, name="weak_signal"):
    """The pattern's return falls as cos(incidence) / z^2; below a threshold a pixel is invalid.

    At `reach` and normal incidence half of the pixels are lost; texture and reflectance vary by
    `spread` (standard deviation of the logarithm). What is not hit at all returns nothing.
    """

    # 10 m (D435i datasheet: depth up to about 10 m)
    reach: PerRobot = parameter(unit="m", null=np.inf, low=0.1, high=1e3)
    # matt surfaces indoors reflect 5 to 80 %: a factor of 4 either way within two standard
    # deviations
    spread: float = field(
        default=0.7, metadata={"unit": "", "low": 0.01, "high": 5.0, "per_joint": False}
    )
    patch: float = field(
        default=5.0, metadata={"unit": "px", "low": 0.5, "high": 50.0, "per_joint": False}
    )
    """Size of the patches that are lost together."""

    def drawn(self, signal: StereoImage, keys: Array) -> StereoImage:
        """Loses what returns too little."""
        disparity, optics = signal.truth, signal.optics
        xp = namespace(disparity)
        draw = self.patches(signal, keys, self.patch)
        # cos / z^2 over that at the reach; disparities stand for 1 / z
        weakest = optics.disparity_at_1m / per_image(self.reach, disparity, xp)
        draw *= self.spread
        needed = xp.exp(draw)
        needed *= weakest * weakest
        square = disparity * disparity
        steepness = square + _slopes_squared(
            disparity, optics.focal_px / optics.pitch_x, optics.focal_px / optics.pitch_y
        )
        # the cosine is disparity over the root of the steepness; both sides squared
        needed *= needed
        needed *= steepness
        strength = square * square
        strength *= square
        return replace(signal, valid=signal.valid & (strength > needed))


def _slopes_squared(disparity: Images, focal_x: float, focal_y: float) -> Images:
    """Square of the slope of the disparity per unit of tangent, for rays near the optical axis.

    A plane's disparity is linear in the image: slopes a, b (per unit of tangent) and value c at the
    pixel make the normal (a, b, c) in the frame of the pixel's own ray, so that the cosine of the
    incidence is c over its length.
    """
    xp = namespace(disparity)
    total = xp.zeros_like(disparity)
    for axis, focal in ((-2, focal_y), (-1, focal_x)):
        along, into = (xp.matrix_transpose(a) if axis == -2 else a for a in (disparity, total))
        slope = abs(along[..., 1:] - along[..., :-1])
        # the smaller of the slopes to both sides, so that an edge does not look like a grazing
        # surface; 0 at borders
        smaller = xp.minimum(slope[..., 1:], slope[..., :-1])
        smaller *= focal
        smaller *= smaller
        into[..., 1:-1] += smaller
    return total
