"""Matching fails where a window straddles an edge."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from saltus.arrays import Array, namespace
from saltus.effects.effect import PerRobot, like, parameter
from saltus.effects.fields import mean_around
from saltus.render.stereo.discontinuity import discontinuity
from saltus.render.stereo.image import StereoImage
from saltus.render.stereo.random_effect import RandomStereoEffect


@dataclass(frozen=True, kw_only=True)
class StereoEdgeHoles(RandomStereoEffect, name="edge_holes"):
    """A share `fraction` of the pixels within `reach` of a depth edge,
    on its far side, is invalid, in patches.

    The near side usually wins the match, so it keeps its pixels.
    """

    # a D435 frame of smooth surfaces (librealsense's tests) loses 12 % of the pixels right beside
    # an edge, 3 % of those within 4.5 px; frames of clutter lose several times that
    fraction: PerRobot = parameter(unit="", null=0.0, low=0.0, high=1.0)
    # half of a matching window of 9 px
    reach: float = field(
        default=4.5, metadata={"unit": "px", "low": 0.5, "high": 50.0, "per_joint": False}
    )
    # a change that is smaller than a pixel still matches as one surface
    jump: float = field(
        default=1.0, metadata={"unit": "px", "low": 0.05, "high": 50.0, "per_joint": False}
    )
    patch: float = field(
        default=3.0, metadata={"unit": "px", "low": 0.5, "high": 50.0, "per_joint": False}
    )
    """Size of the patches that are lost together."""

    def drawn(self, signal: StereoImage, keys: Array) -> StereoImage:
        """Loses pixels at edges."""
        # Here, so that a router, which reads cameras and draws none, needs no SciPy
        from scipy.special import (
            ndtri,
        )

        disparity, optics = signal.truth, signal.optics
        xp = namespace(disparity)
        rows, columns = (
            math.ceil(self.reach / optics.pitch_y),
            math.ceil(self.reach / optics.pitch_x),
        )
        near_edge = signal.windows.any_around(discontinuity(disparity, self.jump), rows, columns)
        mean = mean_around(disparity, rows, columns)
        # samples that reach farther than `reach` make up for it by losing fewer
        excess = max(rows * optics.pitch_y, columns * optics.pitch_x) / self.reach
        draw = self.patches(signal, keys, self.patch)
        share = np.clip(
            np.asarray(self.fraction, dtype=np.float64) / max(1.0, excess), 1e-9, 1.0 - 1e-9
        )
        limit = ndtri(share)
        threshold = float(limit) if limit.ndim == 0 else like(limit, disparity, xp)[..., None, None]
        lost = near_edge & (disparity < mean) & (draw < threshold)
        return replace(signal, valid=signal.valid & ~lost)
