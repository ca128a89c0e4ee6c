"""A temporal filter of the camera's driver mixes an image with those before."""

from dataclasses import dataclass, replace

from saltus.arrays import namespace
from saltus.effects.effect import Effect, PerRobot, parameter, per_image
from saltus.effects.signals import DepthImage


@dataclass(frozen=True, kw_only=True)
class TemporalSmear(Effect[DepthImage], name="temporal_smear", site="depth"):
    """Exponential smoothing: each pixel is `alpha` times the new depth and the rest the last one given out.

    Pixels that are invalid, or see nothing, in either image take the new value. An image that comes again changes
    nothing. librealsense's default is 0.4; `saltus.render.postfilter.TemporalFilter` is its filter with all its
    conditions.
    """

    # weight of the new frame
    alpha: PerRobot = parameter(unit="", null=1.0, low=0.01, high=1.0, sought=(0.04, 1.0))

    def apply(
        self, signal: DepthImage, time_s: float, state: DepthImage | None
    ) -> tuple[DepthImage, DepthImage | None]:
        """Smooths in time; the state is the last image given out."""
        del time_s
        if self.is_null():
            return signal, state
        if state is None:
            return signal, signal
        xp, depth, last = namespace(signal.depth), signal.depth, state.depth
        alpha = per_image(self.alpha, depth, xp)
        zero = xp.zeros_like(depth)
        both = (depth > 0.0) & (last > 0.0) & xp.isfinite(depth) & xp.isfinite(last)
        mixed = alpha * xp.where(both, depth, zero) + (1.0 - alpha) * xp.where(both, last, zero)
        mixed = xp.where(both, mixed, depth)
        again = (signal.time_s == state.time_s)[..., None, None]
        given = replace(signal, depth=xp.where(again, last, mixed))
        return given, given
