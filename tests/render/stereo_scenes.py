"""Scenes whose depth and shadows are known in closed form."""

from typing import Any

import numpy as np

from saltus.depth import Intrinsics
from saltus.render.camera import ray_directions
from saltus.render.stereo.optics import Optics


def wall_and_panel(
    camera: Intrinsics, optics: Optics, wall_m: float, panel_m: float, left: float, right: float, slant: float = 0.0
) -> tuple[Any, Any]:
    """A wall and, before it, a panel of full height between two tangents of the left view; what the right view misses.

    Args:
        camera: of the left image.
        optics: of the pair.
        wall_m: depth of the wall on the optical axis [m].
        panel_m: depth of the panel [m].
        left: tangent of the panel's left edge.
        right: of its right edge.
        slant: of the wall, depth per lateral distance.
    """
    x = ray_directions(camera)[..., 0]
    wall = wall_m / (1.0 - slant * x)
    on_panel = (x >= left) & (x < right)
    depth = np.where(on_panel, panel_m, wall)
    # seen from the right imager, at the depth of the panel
    lateral = optics.baseline_m + (wall * x - optics.baseline_m) * panel_m / wall
    hidden = ~on_panel & (lateral >= left * panel_m) & (lateral < right * panel_m)
    return depth.astype(np.float32), hidden


def flat_wall(camera: Intrinsics, depth_m: float) -> tuple[Any, Any]:
    """A wall across the optical axis; nothing is hidden."""
    shape = camera.height, camera.width
    return np.full(shape, depth_m, dtype=np.float32), np.zeros(shape, dtype=bool)
