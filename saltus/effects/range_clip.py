"""The end of a camera's range: things farther away read as this far."""

import math
from dataclasses import dataclass, replace

from saltus.arrays import namespace
from saltus.effects.effect import Effect, PerRobot, parameter, per_image
from saltus.effects.signals import DepthImage


@dataclass(frozen=True, kw_only=True)
class RangeClip(Effect[DepthImage], name="range_clip", site="depth"):
    """Depths beyond `max` read as `max`, "nothing within range" included; images in metres."""

    # original: 3 m
    max: PerRobot = parameter(unit="m", null=math.inf, low=0.05, high=100.0)

    def apply(self, signal: DepthImage, time_s: float, state: None) -> tuple[DepthImage, None]:
        """Clips."""
        del time_s, state
        xp, depth = namespace(signal.depth), signal.depth
        limit = per_image(self.max, depth, xp) + xp.zeros_like(depth)
        return replace(signal, depth=xp.where(depth > limit, limit, depth)), None
