"""Exact depth of capsules in a pin-hole image."""

import numpy as np
from numpy.typing import NDArray

from render.legs import Capsules
from saltus.depth import Intrinsics
from saltus.messages import Floats

NEAREST = 1e-3  # a capsule that reaches nearer to the image plane than this is looked for in the whole image [m]


def capsules_in_camera(capsules: Capsules, origin: Floats, rotation: Floats) -> Capsules:
    """Moves capsules into a frame with the given origin and rotation (to the frame in which they are given)."""
    move = (capsules.start - origin[..., None, :]) @ rotation, (capsules.end - origin[..., None, :]) @ rotation
    return Capsules(start=move[0], end=move[1], radius=capsules.radius)


def draw_capsules(depth: NDArray[np.float32], capsules: Capsules, directions: Floats, intrinsics: Intrinsics) -> None:
    """Draws capsules into depth images, in place: each pixel keeps what is nearer.

    Args:
        depth: along the optical axis [m], infinite where there is nothing yet; shape (n, height, width).
        capsules: in the camera frames; arrays of shape (n, capsules, 3).
        directions: of the pixels, of depth 1, shape (height, width, 3).
        intrinsics: of the camera.
    """
    rows, columns, seen = _windows(capsules, intrinsics)
    for image, k in np.argwhere(seen):
        window = slice(*rows[image, k]), slice(*columns[image, k])
        hit = capsule_depth(
            capsules.start[image, k], capsules.end[image, k], float(capsules.radius[k]), directions[window]
        )
        part = depth[image][window]
        np.minimum(part, hit, out=part, casting="same_kind")


def capsule_depth(start: Floats, end: Floats, radius: float, directions: Floats) -> Floats:
    """Depth at which rays from the origin enter a capsule; infinite where they miss it.

    Args:
        start: one end of the axis [m], shape (3,).
        end: the other end.
        radius: [m].
        directions: shape (..., 3), of depth 1: the ray's parameter is the depth.

    Returns:
        Shape (...).
    """
    axis = end - start
    length_squared = float(axis @ axis)
    speed_squared = np.sum(directions * directions, axis=-1)
    nearest = np.minimum(
        _ball_depth(start, radius, directions, speed_squared), _ball_depth(end, radius, directions, speed_squared)
    )
    if length_squared == 0.0:
        return nearest
    # the side: distance of the ray's point from the axis line is the radius, a quadratic in depth
    along = directions @ axis
    offset = float(axis @ start)
    a = length_squared * speed_squared - along * along
    b = directions @ (start * length_squared) - offset * along
    c = length_squared * float(start @ start) - offset * offset - radius * radius * length_squared
    inside = b * b - a * c
    depth = (b - np.sqrt(np.maximum(inside, 0.0))) / np.where(a > 0.0, a, 1.0)
    place = depth * along - offset
    hit = (inside >= 0.0) & (a > 0.0) & (place > 0.0) & (place < length_squared) & (depth > 0.0)
    return np.minimum(nearest, np.where(hit, depth, np.inf))


def _ball_depth(centre: Floats, radius: float, directions: Floats, speed_squared: Floats) -> Floats:
    b = directions @ centre
    inside = b * b - speed_squared * (float(centre @ centre) - radius * radius)
    depth = (b - np.sqrt(np.maximum(inside, 0.0))) / speed_squared
    return np.where((inside >= 0.0) & (depth > 0.0), depth, np.inf)


def _windows(
    capsules: Capsules, intrinsics: Intrinsics
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Rows and columns [first, last) that a capsule can cover, shape (n, capsules, 2), and whether there are any."""
    ends = np.stack([capsules.start, capsules.end], axis=-2)
    radius = capsules.radius[:, None]
    near, far = ends[..., 2] - radius, ends[..., 2] + radius
    behind = np.all(far <= 0.0, axis=-1)
    crossing = np.any(near <= NEAREST, axis=-1)
    # the image of a capsule lies in that of the cubes around its two balls, as long as all of it is in front
    depths = np.maximum(np.stack([near, far], axis=-1), NEAREST)

    def window(axis: int, focal: float, centre: float, count: int) -> NDArray[np.int64]:
        low = ((ends[..., axis] - radius)[..., None] / depths).min(axis=(-1, -2)) * focal + centre
        high = ((ends[..., axis] + radius)[..., None] / depths).max(axis=(-1, -2)) * focal + centre
        first = np.where(crossing, 0, np.clip(np.floor(low), 0, count))
        last = np.where(crossing, count, np.clip(np.ceil(high), 0, count))
        return np.stack([first, last], axis=-1).astype(np.int64)

    columns = window(0, intrinsics.fx, intrinsics.cx, intrinsics.width)
    rows = window(1, intrinsics.fy, intrinsics.cy, intrinsics.height)
    seen = ~behind & (rows[..., 1] > rows[..., 0]) & (columns[..., 1] > columns[..., 0])
    return rows, columns, seen
