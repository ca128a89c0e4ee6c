"""A temporal filter of the camera's driver mixes an image with those before."""

from dataclasses import dataclass, replace
from typing import Any

from saltus.arrays import namespace
from saltus.effects.effect import Effect, PerRobot, parameter, per_image
from saltus.effects.signals import DepthImage

Memory = tuple[Any, Any] | None
"""The last image given out, its depth and capture time; None before the first."""


@dataclass(frozen=True, kw_only=True)
class TemporalSmear(Effect[DepthImage], name="temporal_smear", site="depth"):
    """Exponential smoothing: each pixel is `alpha` times the new depth and the rest the last one given out.

    Pixels that are invalid, or see nothing, in either image take the new value. An image that comes again changes
    nothing. librealsense's default is 0.4; `saltus.render.postfilter.TemporalFilter` is its filter with all its
    conditions.
    """

    # weight of the new frame
    alpha: PerRobot = parameter(unit="", null=1.0, low=0.01, high=1.0)

    def apply(self, signal: DepthImage, time_s: float, state: Memory) -> tuple[DepthImage, Memory]:
        """Smooths in time."""
        del time_s
        if self.is_null():
            return signal, state
        if state is None:
            return signal, (signal.depth, signal.time_s)
        last, last_s = state
        xp, depth = namespace(signal.depth), signal.depth
        alpha = per_image(self.alpha, depth, xp)
        zero = xp.zeros_like(depth)
        both = (depth > 0.0) & (last > 0.0) & xp.isfinite(depth) & xp.isfinite(last)
        mixed = alpha * xp.where(both, depth, zero) + (1.0 - alpha) * xp.where(both, last, zero)
        mixed = xp.where(both, mixed, depth)
        again = (signal.time_s == last_s)[..., None, None]
        given = xp.where(again, last, mixed)
        return replace(signal, depth=given), (given, signal.time_s)
