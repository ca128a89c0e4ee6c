"""Which points that the left imager sees terrain can hide from the right one:
few, so few rays have to be cast.

Of a terrain of columns across the course: in the vertical plane along the course, let L and R be
the imagers and P a point that L sees. The line from R to P can only be blocked where an upper
corner C of a column lies in the triangle LRP, so the direction from L to P lies between those of LC
and RC. Between them lies a strip of the image along each corner. Boxes that are no columns leave
every point in doubt.
"""

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.depth import Intrinsics
from saltus.terrain.columns import Columns
from saltus.terrain.terrain import Terrain

SLACK_ROWS = 0.01  # for rounding
SLACK_M = 0.01
Imagers = tuple[Floats, Floats]
"""Places of the left imagers and of the right ones [m], world frame, shape (n, 3) each."""


def doubtful(
    terrain: Terrain,
    camera: Intrinsics,
    origin: Floats,
    rotation: Floats,
    baseline_m: float,
    depth: NDArray[np.float32],
) -> NDArray[np.int64]:
    """Points which the right imager may not see because of terrain.

    It sees all others, or legs hide them.

    Args:
        terrain: what hides.
        camera: of the left images.
        origin: of the left imagers [m], world frame, shape (n, 3).
        rotation: camera to world, shape (n, 3, 3).
        baseline_m: distance of the imagers.
        depth: of the points in the left images, finite [m], shape (n, height, width).

    Returns:
        Ascending places in the flattened images.
    """
    if terrain.columns is None:
        return np.arange(depth.size)
    right = origin + baseline_m * rotation[..., 0]
    found = _beside(terrain.columns, camera, (origin, right), rotation, depth)
    image, first, last, column = _strips(terrain.columns, camera, (origin, right), rotation)
    tall = last - first
    strip = np.repeat(np.arange(len(tall)), tall)
    row = np.arange(len(strip)) + np.repeat(first - np.cumsum(tall) + tall, tall)
    found.reshape(-1)[(image[strip] * camera.height + row) * camera.width + column[strip]] = True
    return np.flatnonzero(found)


def _beside(
    columns: Columns,
    camera: Intrinsics,
    imagers: Imagers,
    rotation: Floats,
    depth: NDArray[np.float32],
) -> NDArray[np.bool_]:
    """Points of which the corners do not tell all:
    not over the course, or seen from beside it or from within it.
    """
    limit = 0.5 * columns.width - SLACK_M
    left, _ = imagers
    strange = np.zeros(len(left), dtype=np.bool_)
    for imager in imagers:
        strange |= abs(imager[:, 1]) > limit
        strange |= columns.height_at(imager[:, 0]) > imager[:, 2] - SLACK_M
    lateral = rotation[:, 1].astype(np.float32)
    x = ((np.arange(camera.width) + 0.5 - camera.cx) / camera.fx).astype(np.float32)
    y = ((np.arange(camera.height) + 0.5 - camera.cy) / camera.fy).astype(np.float32)
    place = (lateral[:, 1:2] * y + lateral[:, 2:])[:, :, None] + (lateral[:, :1] * x)[:, None, :]
    place *= depth
    place += left[:, 1, None, None].astype(np.float32)
    np.abs(place, out=place)
    return (place > limit) | strange[:, None, None]


def _strips(
    columns: Columns, camera: Intrinsics, imagers: Imagers, rotation: Floats
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Image, first row, end of the rows, and column of each part
    of a column of pixels along a corner.
    """
    top = np.concatenate([[-np.inf], columns.top, [-np.inf]])
    corner_x, corner_z = columns.x, np.maximum(top[1:], top[:-1])
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    edges, rises = [], []
    for imager in imagers:
        ahead, up = corner_x - imager[:, :1], corner_z - imager[:, 2:]
        # cross product of the way to the corner and the direction of a pixel: linear in the pixel's
        # tangents
        across, down, forward = (
            ahead * rotation[:, 2, i : i + 1] - up * rotation[:, 0, i : i + 1] for i in range(3)
        )
        safe = np.where(down == 0.0, 1.0, down)[..., None]
        edges.append(-(across[..., None] * x + forward[..., None]) / safe)
        rises.append(down)
    # where both lines turn the same way, what is between them is one strip; else it may be anything
    plain = (rises[0] * rises[1] > 0.0)[..., None]
    low = np.where(plain, np.minimum(*edges), -np.inf) * camera.fy + (camera.cy - 0.5)
    high = np.where(plain, np.maximum(*edges), np.inf) * camera.fy + (camera.cy - 0.5)
    first = np.clip(np.ceil(low - SLACK_ROWS), 0, camera.height).astype(np.int64)
    last = np.clip(np.floor(high + SLACK_ROWS) + 1.0, 0, camera.height).astype(np.int64)
    image, corner, column = np.nonzero(last > first)
    return image, first[image, corner, column], last[image, corner, column], column
