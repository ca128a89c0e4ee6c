"""Occlusion: what only one of the two imagers sees cannot be matched."""

from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import Array, namespace
from saltus.effects.effect import PerRobot, parameter, per_image
from saltus.effects.fields import unit_uniform
from saltus.render.stereo.image import StereoImage
from saltus.render.stereo.random_effect import RandomStereoEffect


@dataclass(frozen=True, kw_only=True)
class BaselineOcclusion(RandomStereoEffect, name="baseline_occlusion"):
    """Points that the right imager does not see are invalid:
    a shadow to the left of every near object.

    The shadow comes from a second view (`saltus.render.renderer.StereoRenderer`), so geometry makes
    its width: f B (1 / z_near - 1 / z_far) pixels. `rejected` is the share of such pixels that the
    camera's left-right check finds; it finds all of them, which is what the check is for (D4 vision
    processor datasheet).
    """

    rejected: PerRobot = parameter(unit="", null=0.0, low=0.0, high=1.0)

    def drawn(self, signal: StereoImage, keys: Array) -> StereoImage:
        """Invalidates what is hidden."""
        lost = signal.hidden
        if not np.all(np.equal(self.rejected, 1.0)):
            dtype = signal.disparity.dtype
            draw = unit_uniform(keys, signal.time_s, signal.hidden.shape[-2:], dtype)
            lost = lost & (draw < per_image(self.rejected, signal.disparity, namespace(draw)))
        return replace(signal, valid=signal.valid & ~lost)
