"""A filter of the camera's driver fills holes with what is to the left of them."""

from dataclasses import dataclass, replace

from saltus.arrays import namespace
from saltus.effects.effect import Effect, PerRobot, parameter, pixels_within
from saltus.effects.signals import DepthImage


@dataclass(frozen=True, kw_only=True)
class HoleFill(Effect[DepthImage], name="hole_fill", site="depth"):
    """An invalid pixel takes the nearest valid value to its left within `reach` pixels, to the nearest pixel.

    One number, as a run log can tell it; `saltus.render.postfilter` has librealsense's filters themselves.
    """

    # librealsense's spatial filter offers 2 to 16 px, or no limit
    reach: PerRobot = parameter(unit="px", null=0.0, low=0.0, high=1000.0, sought=(0.0, 30.0))

    def apply(self, signal: DepthImage, time_s: float, state: None) -> tuple[DepthImage, None]:
        """Fills holes."""
        del time_s, state
        xp, depth = namespace(signal.depth), signal.depth
        filled = xp.asarray(depth, copy=True)
        for k, is_near in pixels_within(self.reach, depth):
            hole = (filled[..., k:] == 0.0) & is_near
            filled[..., k:] = xp.where(hole, depth[..., :-k], filled[..., k:])
        return replace(signal, depth=filled), None
