"""At an edge a matcher may find something between near and far."""

import math
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from saltus.arrays import namespace
from saltus.effects.effect import PerRobot, parameter, per_image
from saltus.effects.fields import unit_uniform, unit_uniform_at
from saltus.render.devices import on_host
from saltus.render.stereo.discontinuity import discontinuity
from saltus.render.stereo.image import StereoImage
from saltus.render.stereo.random_effect import RandomStereoEffect


@dataclass(frozen=True, kw_only=True)
class FlyingPixels(RandomStereoEffect):
    """A share `fraction` of the pixels next to a depth edge has a disparity anywhere between both sides."""

    name: ClassVar[str] = "flying_pixels"

    # not published; one in five makes the thin veil at edges that recordings show
    fraction: PerRobot = parameter(unit="", null=0.0, low=0.0, high=1.0)
    # as for holes at edges
    jump: float = field(default=1.0, metadata={"unit": "px", "low": 0.05, "high": 50.0, "per_joint": False})

    def apply(self, signal: StereoImage, time_s: float, state: Any) -> tuple[StereoImage, Any]:
        """Moves pixels into the gap."""
        del time_s
        if self.is_null():
            return signal, state
        disparity, optics = signal.disparity, signal.optics
        # one sample in `pitch` lies within a pixel of the edge
        scale = 1.0 / max(optics.pitch_x, optics.pitch_y)
        share = per_image(self.fraction, disparity, namespace(disparity)) * scale
        edge = discontinuity(signal.truth, self.jump)
        moved = (
            _at_places(signal, edge, share, state) if on_host(disparity) else _everywhere(signal, edge, share, state)
        )
        return replace(signal, disparity=moved), state


def _everywhere(signal: StereoImage, edge: Any, share: Any, keys: Any) -> Any:
    """The disparity with what flies, from operations on whole images: none waits for a device."""
    disparity = signal.disparity
    draw = unit_uniform(keys, signal.time_s, disparity.shape[-2:], disparity.dtype)
    low, high = signal.windows.range_around(disparity)
    # among those that fly, draw / share is uniform again
    return namespace(disparity).where(edge & (draw < share), low + (high - low) * (draw / share), disparity)


def _at_places(signal: StereoImage, edge: Any, share: Any, keys: Any) -> Any:
    """The same, to the bit, from a list of the places at edges, which are few."""
    disparity = signal.disparity
    xp, shape = namespace(disparity), disparity.shape[-2:]
    (place,) = xp.nonzero(xp.reshape(edge, (-1,)))
    draw = unit_uniform_at(place, keys, signal.time_s, shape, disparity.dtype)
    if not isinstance(share, float):
        share = xp.reshape(xp.broadcast_to(share, (*disparity.shape[:-2], 1, 1)), (-1,))[place // math.prod(shape)]
    flies = draw < share
    place, draw = place[flies], draw[flies]
    low, high = _limits(disparity, place)
    between = low + (high - low) * (draw / (share if isinstance(share, float) else share[flies]))
    result = xp.reshape(xp.asarray(disparity, copy=True), (-1,))
    result[place] = between
    return xp.reshape(result, disparity.shape)


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
