"""Which ground a camera has seen, and how long ago: what can be known of it at all."""

import numpy as np
from numpy.typing import NDArray

from saltus import rotations
from saltus.arrays import Floats
from saltus.grid import HeightGrid
from saltus.heightmap.data.delivery import TICK_S
from saltus.heightmap.evaluation.comparison import in_view
from saltus.render.camera import camera_pose
from saltus.robots.mount import Mount
from saltus.terrain.terrain import Terrain

VISIBLE, REMEMBERED, UNSEEN = 0, 1, 2
VIEWS = ("visible", "remembered", "unseen")
"""Names of the three: seen in the last 0.2 s, seen earlier in this run, never seen."""
RECENT_S = 0.2
BIN_M = 0.01  # of the ground: a quarter of the grid's spacing
_MARGIN_M = 4.0  # the camera sees to 3 m, from less than 1 m ahead of the base
_NEAREST_M = 0.02  # ground below the camera has no slope


def visibility(
    terrain: Terrain,
    mount: Mount,
    grid: HeightGrid,
    position: Floats,
    quaternion: Floats,
    captured_s: Floats,
) -> NDArray[np.int8]:
    """When each point of the heightmap was last seen, in images that the robot has got.

    Legs are not in the way here.

    Args:
        terrain: Under the robot.
        mount: Of its camera.
        grid: A line of points ahead.
        position: True, of the base at each tick from 0 on [m], shape (ticks, 3).
        quaternion: The same, shape (ticks, 4).
        captured_s: Capture time of the image in use, minus infinity before the first [s], shape
            (ticks,).

    Returns:
        `VISIBLE`, `REMEMBERED` or `UNSEEN`, shape (ticks, rows).
    """
    ground = np.arange(position[:, 0].min() - _MARGIN_M, position[:, 0].max() + _MARGIN_M, BIN_M)
    taken = np.unique(np.rint(captured_s[np.isfinite(captured_s)] / TICK_S).astype(np.int64))
    rays = seen_by_rays(terrain, mount, ground, position[taken], quaternion[taken])
    seen = dict(zip(taken.tolist(), rays, strict=True))
    _, _, yaw = rotations.roll_pitch_yaw(rotations.rotation_matrix(quaternion))
    points, _ = grid.points_in_world(position, yaw)
    place = np.rint((points - ground[0]) / BIN_M).astype(np.int64)
    last_s = np.full(len(ground), -np.inf)
    result = np.empty(points.shape, np.int8)
    for tick, image_s in enumerate(captured_s):
        if np.isfinite(image_s):
            last_s[seen[round(image_s / TICK_S)]] = image_s
        ago_s = tick * TICK_S - last_s[place[tick]]
        result[tick] = np.where(
            ago_s <= RECENT_S, VISIBLE, np.where(np.isfinite(ago_s), REMEMBERED, UNSEEN)
        )
    return result


def seen_by_rays(
    terrain: Terrain, mount: Mount, ground: Floats, position: Floats, quaternion: Floats
) -> NDArray[np.bool_]:
    """Ground on the robot's heading that is in the field of view,
    within range, and behind nothing.

    Args:
        terrain: Under the robot.
        mount: Of its camera.
        grid: A line of points ahead.
        ground: Places along the course, ascending [m], shape (m,).
        position: Of the base when each image is taken [m], shape (n, 3).
        quaternion: The same, shape (n, 4).

    Returns:
        Shape (n, m).
    """
    _, _, yaw = rotations.roll_pitch_yaw(rotations.rotation_matrix(quaternion))
    aside = position[:, 1:2] + np.tan(yaw)[:, None] * (ground - position[:, :1])
    height = terrain.height_at(np.broadcast_to(ground, aside.shape), aside)
    place = np.stack(np.broadcast_arrays(ground, aside, height), axis=-1)
    origin, _ = camera_pose(mount, position, quaternion)
    ahead = ground - np.asarray(origin)[:, :1]
    slope = np.where(
        ahead > _NEAREST_M,
        (height - np.asarray(origin)[:, 2:]) / np.maximum(ahead, _NEAREST_M),
        -np.inf,
    )
    # A place is hidden where one before it looks higher.
    clear = (slope >= np.maximum.accumulate(slope, axis=1)) & np.isfinite(slope)
    return clear & in_view(mount, place, position, quaternion)
