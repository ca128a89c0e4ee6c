"""Surfaces that return too little of the projected pattern cannot be matched: far ones and grazing ones."""

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from render.stereo.fields import gaussian, padded, samples
from render.stereo.image import StereoImage
from render.stereo.per_image import per_image
from saltus.arrays import namespace
from saltus.effects.draws import draw_keys
from saltus.effects.effect import Effect, PerRobot, Site, parameter


@dataclass(frozen=True, kw_only=True)
class WeakSignal(Effect[StereoImage]):
    """The pattern's return falls as cos(incidence) / z^2; below a threshold a pixel is invalid.

    At `reach` and normal incidence half of the pixels are lost; texture and reflectance vary by `spread` (standard
    deviation of the logarithm). What is not hit at all returns nothing.
    """

    name: ClassVar[str] = "weak_signal"
    site: ClassVar[Site] = "depth"

    # 10 m (D435i datasheet: depth up to about 10 m)
    reach: PerRobot = parameter(unit="m", null=np.inf, low=0.1, high=1e3)
    # matt surfaces indoors reflect 5 to 80 %: a factor of 4 either way within two standard deviations
    spread: float = field(default=0.7, metadata={"unit": "", "low": 0.01, "high": 5.0, "per_joint": False})
    patch: float = field(default=5.0, metadata={"unit": "px", "low": 0.5, "high": 50.0, "per_joint": False})
    """Size of the patches that are lost together."""

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> Any:
        """A key for each image."""
        return draw_keys(batch, rng)

    def apply(self, signal: StereoImage, time_s: float, state: Any) -> tuple[StereoImage, Any]:
        """Loses what returns too little."""
        del time_s
        if self.is_null():
            return signal, state
        disparity, optics = signal.truth, signal.optics
        xp = namespace(disparity)
        window = samples(self.patch, optics.pitch_y), samples(self.patch, optics.pitch_x)
        draw = gaussian(state, signal.time_s, disparity.shape[-2:], window, disparity.dtype)
        # cos / z^2 over that at the reach; disparities stand for 1 / z
        weakest = optics.disparity_at_1m / per_image(self.reach, disparity, xp)
        needed = xp.exp(self.spread * draw) * (weakest * weakest)
        found = (
            _cosine(disparity, optics.focal_px / optics.pitch_x, optics.focal_px / optics.pitch_y) * disparity**2
            > needed
        )
        return replace(signal, valid=signal.valid & found), state


def _cosine(disparity: Any, focal_x: float, focal_y: float) -> Any:
    """Cosine of the angle between line of sight and surface normal, at most 1, for rays near the optical axis.

    A plane's disparity is linear in the image: slopes a, b (per unit of tangent) and value c at the pixel make the
    normal (a, b, c) in the frame of the pixel's own ray.
    """
    xp = namespace(disparity)
    tall, wide = padded(disparity, 1, -2), padded(disparity, 1, -1)
    # the smaller of the slopes to both sides, so that an edge does not look like a grazing surface
    across = focal_x * _smaller(xp, wide[..., 1:-1] - wide[..., :-2], wide[..., 2:] - wide[..., 1:-1])
    down = focal_y * _smaller(xp, tall[..., 1:-1, :] - tall[..., :-2, :], tall[..., 2:, :] - tall[..., 1:-1, :])
    square = disparity * disparity
    return xp.sqrt(square / (square + across * across + down * down + 1e-12))


def _smaller(xp: Any, one: Any, other: Any) -> Any:
    return xp.minimum(xp.abs(one), xp.abs(other))
