"""Holes to the left of near objects, which only one of two imagers sees past: nothing can be matched there."""

from dataclasses import dataclass, replace

from saltus.arrays import namespace
from saltus.effects.effect import Effect, PerRobot, parameter, pixels_within
from saltus.effects.signals import DepthImage

JUMP = 0.08  # of the depth behind; a smaller step hides less than a pixel from the other imager


@dataclass(frozen=True, kw_only=True)
class EdgeHoles(Effect[DepthImage], name="edge_holes", site="depth"):
    """The `width` pixels to the left of every near edge are invalid, to the nearest pixel of the image.

    One number for all edges, as a run log can tell it; `saltus.render.stereo` has the physics, in which it grows with
    the step of disparity.
    """

    width: PerRobot = parameter(unit="px", null=0.0, low=0.0, high=100.0, sought=(0.0, 30.0))

    def apply(self, signal: DepthImage, time_s: float, state: None) -> tuple[DepthImage, None]:
        """Loses pixels."""
        del time_s, state
        xp, depth = namespace(signal.depth), signal.depth
        lost = xp.zeros_like(depth, dtype=xp.bool)
        behind, before = depth[..., :-1], depth[..., 1:]
        edge = (before > 0.0) & (before < (1.0 - JUMP) * behind)
        for k, is_wide in pixels_within(self.width, depth):
            reached = edge[..., k - 1 :]
            lost[..., : reached.shape[-1]] |= reached & is_wide
        return replace(signal, depth=xp.where(lost, xp.zeros_like(depth), depth)), None
