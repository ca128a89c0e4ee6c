"""Which points of a depth image the right imager does not see, from a second image rendered there."""

from dataclasses import replace
from typing import Any

import numpy as np

from saltus.arrays import namespace
from saltus.depth import Intrinsics
from saltus.render.camera import Mount
from saltus.render.stereo.optics import Optics

TOLERANCE_PX = 1.0  # in disparity: half a sample of the second image on a surface as steep as can be matched


def right_mount(mount: Mount, optics: Optics) -> Mount:
    """Where the right imager sits."""
    return replace(mount, position=mount.position + mount.rotation @ np.array([optics.baseline_m, 0.0, 0.0]))


def right_camera(camera: Intrinsics, optics: Optics, nearest_m: float) -> Intrinsics:
    """A camera at the right imager that sees all that `camera`, at the left one, sees from `nearest_m` on.

    It is wider to the left by the largest disparity; what lies outside it counts as in sight.
    """
    extra = int(np.ceil(optics.disparity_at_1m / nearest_m / optics.pitch_x))
    return replace(camera, width=camera.width + extra, cx=camera.cx + extra)


def hidden_from(depth: Any, right_depth: Any, optics: Optics) -> Any:
    """Whether the right imager does not see the points of the left image.

    Args:
        depth: from the left imager [m], shape (..., height, width).
        right_depth: from the camera of `right_camera`, shape (..., height, width + extra).
        optics: of the left image.

    Returns:
        bool, shape (..., height, width).
    """
    xp = namespace(depth)
    width, wide = depth.shape[-1], right_depth.shape[-1]
    disparity, right = optics.disparity_at_1m / depth, optics.disparity_at_1m / right_depth
    column = xp.arange(width, dtype=depth.dtype, device=depth.device) + float(wide - width)
    place = xp.round(column - disparity * (1.0 / optics.pitch_x))
    inside = place >= 0.0
    index = xp.astype(xp.where(inside, place, xp.zeros_like(place)), xp.int64)
    seen = xp.take_along_axis(right, index, axis=-1)
    return inside & (seen > disparity + TOLERANCE_PX)
