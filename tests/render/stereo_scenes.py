"""Scenes whose depth and shadows are known in closed form, and robots to look from."""

from typing import Any

import numpy as np
from samples import ROBOT

from saltus.arrays import Floats
from saltus.depth import Intrinsics
from saltus.render.camera import ray_directions
from saltus.render.stereo.optics import StereoOptics
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.terrain.terrain import Terrain


def wall_and_panel(
    camera: Intrinsics,
    optics: StereoOptics,
    wall_m: float,
    panel_m: float,
    left: float,
    right: float,
    slant: float = 0.0,
) -> tuple[Any, Any]:
    """A wall and, before it, a panel of full height between two tangents of the left view.

    What the right view misses.

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


def poses(terrain: Terrain, count: int, seed: int) -> tuple[Floats, Floats, Floats]:
    """Robots in mid-jump.

    In five of six the legs reach inwards and ahead as far as they can, into the image.
    """
    rng = np.random.default_rng(seed)
    position = rng.uniform([0.0, -0.3, 0.3], [terrain.finish_x, 0.3, 0.7], (count, 3))
    position[:, 2] += terrain.height_at(position[:, 0], position[:, 1])
    quaternion = quaternion_from_roll_pitch_yaw(*rng.uniform(-0.3, 0.3, (3, count)))
    joints = ROBOT.stand_pose + rng.uniform(-0.4, 0.4, (count, 12))
    ahead = joints.reshape(count, 4, 3)[: count - count // 6]
    ahead[..., 0] = ROBOT.side * rng.uniform(-0.86, -0.65, ahead.shape[:2])
    ahead[..., 1] = rng.uniform(-0.68, -0.2, ahead.shape[:2])
    ahead[..., 2] = rng.uniform(-1.2, -0.9, ahead.shape[:2])
    return position, quaternion, joints
