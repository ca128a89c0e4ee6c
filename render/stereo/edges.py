"""Depth edges: holes beside them, where a window straddles both sides,
and pixels that fly between near and far.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import Array, Images, Masks, namespace
from saltus.effects.effect import PerRobot, as_parameter_of, parameter, per_image, setting
from saltus.effects.random_fields import mean_around, unit_uniform
from saltus.render.stereo.image import StereoImage
from saltus.render.stereo.random_effect import RandomStereoEffect


def beside_disparity_edge(disparity: Images, jump: float) -> Masks:
    """Samples next to a step of more than `jump` [px] in disparity,
    on both sides of it, bool, shape as `disparity`.

    The disparity of a plane is linear in the image, so the second difference is 0 on every plane,
    however slanted.
    """
    xp = namespace(disparity)
    found = xp.zeros_like(disparity, dtype=xp.bool)
    for axis in (-2, -1):
        if disparity.shape[axis] < 2:
            continue
        across, broken = (xp.matrix_transpose(a) if axis == -2 else a for a in (disparity, found))
        slope = across[..., 1:] - across[..., :-1]
        bend = abs(slope[..., 1:] - slope[..., :-1])
        broken[..., 1:-1] |= bend > jump
        # beyond the border all is as at the border
        broken[..., 0] |= abs(slope[..., 0]) > jump
        broken[..., -1] |= abs(slope[..., -1]) > jump
    return found


@dataclass(frozen=True, kw_only=True)
class StereoEdgeHoles(RandomStereoEffect, name="edge_holes"):
    """A share `fraction` of the pixels within `reach` of a depth edge, on its far side, is invalid,
    in patches.

    The near side usually wins the match, so it keeps its pixels.
    """

    # a D435 frame of smooth surfaces (librealsense's tests) loses 12 % of the pixels right beside
    # an edge, 3 % of those within 4.5 px; frames of clutter lose several times that
    fraction: PerRobot = parameter(unit="", null=0.0, low=0.0, high=1.0)
    # half of a matching window of 9 px
    reach: float = setting(4.5, unit="px", low=0.5, high=50.0)
    # a change that is smaller than a pixel still matches as one surface
    jump: float = setting(1.0, unit="px", low=0.05, high=50.0)
    patch: float = setting(3.0, unit="px", low=0.5, high=50.0)
    """Size of the patches that are lost together."""

    def drawn(self, signal: StereoImage, keys: Array) -> StereoImage:
        """Loses pixels at edges."""
        # Here, so that a router, which reads cameras and draws none, needs no SciPy
        from scipy.special import ndtri

        disparity, optics = signal.truth, signal.optics
        xp = namespace(disparity)
        rows, columns = (
            math.ceil(self.reach / optics.pitch_y),
            math.ceil(self.reach / optics.pitch_x),
        )
        near_edge = signal.windows.any_around(
            beside_disparity_edge(disparity, self.jump), rows, columns
        )
        mean = mean_around(disparity, rows, columns)
        # samples that reach farther than `reach` make up for it by losing fewer
        excess = max(rows * optics.pitch_y, columns * optics.pitch_x) / self.reach
        draw = self.patches(signal, keys, self.patch)
        share = np.clip(
            np.asarray(self.fraction, dtype=np.float64) / max(1.0, excess), 1e-9, 1.0 - 1e-9
        )
        limit = ndtri(share)
        threshold = (
            float(limit)
            if limit.ndim == 0
            else as_parameter_of(limit, disparity, xp)[..., None, None]
        )
        lost = near_edge & (disparity < mean) & (draw < threshold)
        return replace(signal, valid=signal.valid & ~lost)


@dataclass(frozen=True, kw_only=True)
class FlyingPixels(RandomStereoEffect, name="flying_pixels"):
    """A share `fraction` of the pixels next to a depth edge
    has a disparity anywhere between both sides.
    """

    # not published; one in five makes the thin veil at edges that recordings show
    fraction: PerRobot = parameter(unit="", null=0.0, low=0.0, high=1.0)
    # as for holes at edges
    jump: float = setting(1.0, unit="px", low=0.05, high=50.0)

    def drawn(self, signal: StereoImage, keys: Array) -> StereoImage:
        """Moves pixels into the gap."""
        disparity, optics = signal.disparity, signal.optics
        # one sample in `pitch` lies within a pixel of the edge
        scale = 1.0 / max(optics.pitch_x, optics.pitch_y)
        share = per_image(self.fraction, disparity, namespace(disparity)) * scale
        draw = unit_uniform(keys, signal.time_s, disparity.shape[-2:], disparity.dtype)
        flies = beside_disparity_edge(signal.truth, self.jump) & (draw < share)
        low, high = signal.windows.range_around(disparity)
        # among those that fly, draw / share is uniform again; where the share is 0 none do
        between = low + (high - low) * (draw / (share + (share == 0.0)))
        return replace(signal, disparity=namespace(disparity).where(flies, between, disparity))
