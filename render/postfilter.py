"""The filters that librealsense offers for depth images, as the original's robot ran them.

Order: hole filling, spatial, temporal, on depth in whole units (not on disparity). All follow the behaviour of
librealsense 2 on 16-bit depth, scan order included, with whole-array operations for numpy and torch alike.

What that behaviour amounts to at the original's settings: blending neighbours that differ by at most `delta` moves a
pixel by less than (1 - alpha) delta, which is below half a unit at alpha = 0.75 and delta = 1, so rounding undoes all
smoothing. Only holes are filled.
"""

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from saltus.arrays import namespace
from saltus.depth import MILLIMETRE
from saltus.effects.effect import Effect, Site, parameter
from saltus.effects.signals import DepthImage

HOLE_RADIUS = (0, 2, 4, 8, 16, 255)  # pixels by level of the spatial filter's option (librealsense)


def _unit() -> Any:
    """The depth unit [m]: what filters round to and count differences in."""
    return field(default=MILLIMETRE, metadata={"unit": "m", "low": 1e-6, "high": 0.1, "per_joint": False})


@dataclass(frozen=True, kw_only=True)
class HoleFilling(Effect[DepthImage]):
    """An invalid pixel takes the nearest depth among its neighbours above, to the left and below left.

    Pixels are visited row by row, so filled ones fill others. The pixel above must be valid, or filled: holes that
    begin in the top row stay. The first column, the top and the bottom row are not filled.
    """

    name: ClassVar[str] = "hole_filling"
    site: ClassVar[Site] = "depth"

    # 2 is "nearest from around" (original)
    mode: float = parameter(unit="", null=0.0, low=2.0, high=2.0)

    def apply(self, signal: DepthImage, time_s: float, state: None) -> tuple[DepthImage, None]:
        """Fills holes."""
        del time_s, state
        if self.is_null() or min(signal.depth.shape[-2:]) < 3:
            return signal, None
        return replace(signal, depth=_filled_from_around(signal.depth)), None


def _filled_from_around(depth: Any) -> Any:
    xp = namespace(depth)
    empty = depth == 0.0
    far = xp.where(empty, xp.full_like(depth, float("inf")), depth)
    # every pixel that has anything above it in its column gets filled, unless it lies on the border
    reached = xp.cumulative_sum(xp.astype(~empty[..., :-2, 1:], xp.int32), axis=-2) > 0
    hole = empty[..., 1:-1, 1:] & reached
    if not bool(xp.any(hole)):
        return depth
    infinite = xp.full_like(far[..., 1:-1, 1:], float("inf"))
    # the row below has not been visited: only what it holds by itself counts
    below = xp.minimum(far[..., 2:, :-1], far[..., 2:, 1:])
    start = xp.where(hole, below, far[..., 1:-1, 1:])
    open_hole = xp.where(hole, -infinite, infinite)
    inner = start
    while True:
        ring = xp.concat([far[..., :1, 1:], inner[..., :-1, :]], axis=-2)
        left = xp.concat([far[..., 1:-1, :1], inner[..., :-1]], axis=-1)
        corner = xp.concat([far[..., :-2, :1], ring[..., :-1]], axis=-1)
        # outside holes the bound of plus infinity keeps the pixel
        offered = xp.minimum(xp.minimum(ring, corner), left)
        following = xp.minimum(inner, xp.maximum(offered, -open_hole))
        following = xp.where(hole, xp.minimum(inner, offered), inner)
        if bool(xp.all(following == inner)):
            break
        inner = following
    result = xp.asarray(depth, copy=True)
    result[..., 1:-1, 1:] = xp.where(hole, inner, depth[..., 1:-1, 1:])
    return result
