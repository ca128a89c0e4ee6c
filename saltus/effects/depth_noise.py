"""A stereo matcher finds each disparity only up to a fraction of a pixel."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from saltus.arrays import namespace
from saltus.depth import BASELINE_M, D435I
from saltus.effects.draws import draw_keys
from saltus.effects.effect import Effect, PerRobot, parameter, per_image
from saltus.effects.fields import gaussian
from saltus.effects.signals import DepthImage


@dataclass(frozen=True, kw_only=True)
class DepthNoise(Effect[DepthImage], name="depth_noise", site="depth"):
    """White noise of standard deviation z^2 `subpixel_sigma` / (f B) at each pixel; images in metres."""

    # 0.08 px in practice, 0.03 px at best (Intel on the D4xx)
    subpixel_sigma: PerRobot = parameter(unit="px", null=0.0, low=0.0, high=5.0)
    # of the image whose pixels `subpixel_sigma` counts (original: D435i at 424x240)
    focal_px: float = field(default=D435I.fx, metadata={"unit": "px", "low": 1.0, "high": 1e4, "per_joint": False})

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> Any:
        """A key for each robot."""
        return draw_keys(batch, rng)

    def apply(self, signal: DepthImage, time_s: float, state: Any) -> tuple[DepthImage, Any]:
        """Adds noise to what is valid and finite; an image that comes again has the same noise."""
        del time_s
        if self.is_null():
            return signal, state
        xp, depth = namespace(signal.depth), signal.depth
        hit = (depth > 0.0) & xp.isfinite(depth)
        near = xp.where(hit, depth, xp.zeros_like(depth))
        sigma = per_image(self.subpixel_sigma, depth, xp) * (1.0 / (self.focal_px * BASELINE_M))
        noise = gaussian(state, signal.time_s, depth.shape[-2:], (1, 1), depth.dtype)
        noisy = near + sigma * near * near * noise
        noisy = xp.where(noisy > 0.0, noisy, xp.zeros_like(depth))
        return replace(signal, depth=xp.where(hit, noisy, depth)), state
