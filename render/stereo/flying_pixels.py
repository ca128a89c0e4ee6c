"""At an edge a matcher may find something between near and far."""

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from render.stereo.discontinuity import discontinuity
from render.stereo.fields import around, unit_uniform
from render.stereo.image import StereoImage
from render.stereo.per_image import per_image
from saltus.arrays import namespace
from saltus.effects.draws import draw_keys
from saltus.effects.effect import Effect, PerRobot, Site, parameter


@dataclass(frozen=True, kw_only=True)
class FlyingPixels(Effect[StereoImage]):
    """A share `fraction` of the pixels next to a depth edge has a disparity anywhere between both sides."""

    name: ClassVar[str] = "flying_pixels"
    site: ClassVar[Site] = "depth"

    # not published; one in five makes the thin veil at edges that recordings show
    fraction: PerRobot = parameter(unit="", null=0.0, low=0.0, high=1.0)
    # as for holes at edges
    jump: float = field(default=1.0, metadata={"unit": "px", "low": 0.05, "high": 50.0, "per_joint": False})

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> Any:
        """A key for each image."""
        return draw_keys(batch, rng)

    def apply(self, signal: StereoImage, time_s: float, state: Any) -> tuple[StereoImage, Any]:
        """Moves pixels into the gap."""
        del time_s
        if self.is_null():
            return signal, state
        disparity, optics = signal.disparity, signal.optics
        xp = namespace(disparity)
        draw = unit_uniform(state, signal.time_s, disparity.shape[-2:], disparity.dtype)
        # one sample in `pitch` lies within a pixel of the edge
        share = per_image(self.fraction, disparity, xp) * (1.0 / max(optics.pitch_x, optics.pitch_y))
        flying = discontinuity(signal.truth, self.jump) & (draw < share)
        low, high = around(disparity, 1, 1, xp.minimum), around(disparity, 1, 1, xp.maximum)
        # among those that fly, draw / share is uniform again
        between = low + (high - low) * (draw / xp.clip(share + 0.0 * draw, min=1e-12))
        return replace(signal, disparity=xp.where(flying, between, disparity)), state
