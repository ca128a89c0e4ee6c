"""At an edge a matcher may find something between near and far."""

import math
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from render.stereo.discontinuity import discontinuity
from render.stereo.fields import unit_uniform_at
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
        xp, shape = namespace(disparity), disparity.shape[-2:]
        (edge,) = xp.nonzero(xp.reshape(discontinuity(signal.truth, self.jump), (-1,)))
        draw = unit_uniform_at(edge, state, signal.time_s, shape, disparity.dtype)
        # one sample in `pitch` lies within a pixel of the edge
        share = per_image(self.fraction, disparity, xp) * (1.0 / max(optics.pitch_x, optics.pitch_y))
        if not isinstance(share, float):
            share = xp.reshape(xp.broadcast_to(share, (*disparity.shape[:-2], 1, 1)), (-1,))[edge // math.prod(shape)]
        flies = draw < share
        place, draw = edge[flies], draw[flies]
        low, high = _limits(disparity, place)
        # among those that fly, draw / share is uniform again
        between = low + (high - low) * (draw / (share if isinstance(share, float) else share[flies]))
        result = xp.reshape(xp.asarray(disparity, copy=True), (-1,))
        result[place] = between
        return replace(signal, disparity=xp.reshape(result, disparity.shape)), state


def _limits(disparity: Any, place: Any) -> tuple[Any, Any]:
    """The least and the largest disparity among the nine around places of the flattened image."""
    xp = namespace(disparity)
    height, width = disparity.shape[-2:]
    near = xp.arange(-1, 2, device=disparity.device)
    first = place // width // height * height
    # beyond the border all is as at the border
    row = first + xp.clip(place // width - first + near[:, None], 0, height - 1)
    column = xp.clip(place % width + near[:, None], 0, width - 1)
    around = xp.reshape(disparity, (-1,))[row[:, None] * width + column]
    return xp.min(around, axis=(0, 1)), xp.max(around, axis=(0, 1))
