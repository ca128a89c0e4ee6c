"""Exact depth of capsules in a pin-hole image."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.depth import Intrinsics
from saltus.robots.leg_shapes import Capsules

# What is nearer to the image plane than this is taken to be this far [m]: bounds the window it is
# in
NEAREST = 1e-3
# Pixels that are worked on together: their numbers stay in the processor's cache
PIXELS_PER_PASS = 1 << 14


def capsules_in_camera(capsules: Capsules, origin: Floats, rotation: Floats) -> Capsules:
    """Moves capsules into a frame with the given origin
    and rotation (to the frame in which they are given).
    """
    move = (
        (capsules.start - origin[..., None, :]) @ rotation,
        (capsules.end - origin[..., None, :]) @ rotation,
    )
    return Capsules(start=move[0], end=move[1], radius=capsules.radius)


def draw_capsules(
    depth: NDArray[np.float32], capsules: Capsules, directions: Floats, intrinsics: Intrinsics
) -> None:
    """Draws capsules into depth images, in place: each pixel keeps what is nearer.

    All images are worked on together, pixel by pixel of the windows in which capsules can be.

    Args:
        depth: along the optical axis [m], infinite where there is nothing yet; shape (n, height,
            width), contiguous.
        capsules: in the camera frames; arrays of shape (n, capsules, 3).
        directions: of the pixels, of depth 1, shape (height, width, 3).
        intrinsics: of the camera.
    """
    rows, columns, seen = capsule_windows(capsules, intrinsics)
    image, k = np.nonzero(seen)
    quadrics = Quadrics.of(capsules.start[image, k], capsules.end[image, k], capsules.radius[k])
    x, y = (
        np.ascontiguousarray(directions[..., 0]).reshape(-1),
        np.ascontiguousarray(directions[..., 1]).reshape(-1),
    )
    flat_depth = depth.reshape(-1)
    for owner, pixel in _pixels(rows[image, k], columns[image, k], intrinsics.width):
        hit = quadrics.take(owner).depth(x[pixel], y[pixel])
        found = np.flatnonzero(hit < np.inf)
        place = image[owner[found]] * (intrinsics.width * intrinsics.height) + pixel[found]
        np.minimum.at(flat_depth, place, hit[found].astype(np.float32))


@dataclass(frozen=True, kw_only=True, eq=False)
class Quadrics:
    """Coefficients of the depth at which any ray enters the capsules of a robot's legs."""

    start: Floats
    """Component first [m], shape (3, ...)."""
    axis: Floats
    """From the start to the end [m], shape (3, ...)."""
    length_squared: Floats
    """Shape (...), as those that follow."""
    offset: Floats
    """Start along the axis, times its length."""
    start_ball: Floats
    end_ball: Floats
    side: Floats
    """Terms of the three quadratics in depth that do not depend on the ray."""

    @classmethod
    def of(cls, start: Floats, end: Floats, radius: Floats | float) -> "Quadrics":
        """Quadrics of capsules with axes from start to end [m],
        shape (..., 3), and a radius [m], shape (...).
        """
        first, last = np.moveaxis(start, -1, 0), np.moveaxis(end, -1, 0)
        axis = last - first
        length_squared, offset, distance_squared = (
            _dot(axis, axis),
            _dot(axis, first),
            _dot(first, first),
        )
        radius_squared = np.square(radius)
        return cls(
            start=first,
            axis=axis,
            length_squared=length_squared,
            offset=offset,
            start_ball=distance_squared - radius_squared,
            end_ball=_dot(last, last) - radius_squared,
            side=length_squared * (distance_squared - radius_squared) - offset * offset,
        )

    def take(self, index: NDArray[np.int64]) -> "Quadrics":
        """Quadrics of some of the capsules, by their indices, for arrays of shape (n,)."""
        return Quadrics(
            **{name: np.take(value, index, axis=-1) for name, value in vars(self).items()}
        )

    def depth(self, x: Floats, y: Floats) -> Floats:
        """The least depth at which a ray is within the radius of an end
        or of the line between them; else infinite.

        Args:
            x: tangent of the ray to the right, shape (...).
            y: tangent of the ray downwards, shape (...).
        """
        speed_squared = x * x + y * y + 1.0
        to_start = x * self.start[0] + y * self.start[1] + self.start[2]
        along = x * self.axis[0] + y * self.axis[1] + self.axis[2]
        nearest = np.minimum(
            _first_root(speed_squared, to_start, self.start_ball),
            _first_root(speed_squared, to_start + along, self.end_ball),
        )
        # the side: distance of the ray's point from the axis line is the radius
        a = self.length_squared * speed_squared - along * along
        b = self.length_squared * to_start - self.offset * along
        depth = _first_root(a, b, self.side)
        place = np.where(depth < np.inf, depth, 0.0) * along - self.offset
        return np.minimum(
            nearest, np.where((place > 0.0) & (place < self.length_squared), depth, np.inf)
        )


def _first_root(a: Floats, b: Floats, c: Floats) -> Floats:
    """The lesser t with a t^2 - 2 b t + c = 0.

    Infinite where there is none or it is not positive.
    """
    inside = b * b - a * c
    root = (b - np.sqrt(np.maximum(inside, 0.0))) / np.where(a > 0.0, a, 1.0)
    return np.where((inside >= 0.0) & (a > 0.0) & (root > 0.0), root, np.inf)


def _dot(left: Floats, right: Floats) -> Floats:
    """Inner product over the first axis.

    By components, so that it does not depend on the other dimensions.
    """
    return left[0] * right[0] + left[1] * right[1] + left[2] * right[2]


def capsule_windows(
    capsules: Capsules, intrinsics: Intrinsics
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Where in an image capsules, in the camera frames, arrays of shape (n, capsules, 3), can be.

    Returns:
        Rows and columns [first, last), each of shape (n, capsules, 2), and whether there are any,
        shape (n, capsules).
    """
    start, end = _in_front(capsules)
    radius = capsules.radius
    low, high = np.minimum(start, end) - radius[:, None], np.maximum(start, end) + radius[:, None]
    # the image of a capsule lies in that of the box around it
    nearest, farthest = np.maximum(low[..., 2], NEAREST), np.maximum(high[..., 2], NEAREST)

    def window(axis: int, focal: float, centre: float, count: int) -> NDArray[np.int64]:
        first = np.minimum(low[..., axis] / nearest, low[..., axis] / farthest) * focal + centre
        last = np.maximum(high[..., axis] / nearest, high[..., axis] / farthest) * focal + centre
        return np.stack(
            [np.clip(np.floor(first), 0, count), np.clip(np.ceil(last), 0, count)], axis=-1
        ).astype(int)

    columns = window(0, intrinsics.fx, intrinsics.cx, intrinsics.width)
    rows = window(1, intrinsics.fy, intrinsics.cy, intrinsics.height)
    seen = (
        (high[..., 2] > 0.0) & (rows[..., 1] > rows[..., 0]) & (columns[..., 1] > columns[..., 0])
    )
    return rows, columns, seen


def _in_front(capsules: Capsules) -> tuple[Floats, Floats]:
    """Both ends of the part of each axis from
    which the capsule reaches in front of the image plane.
    """
    start, end = capsules.start, capsules.end
    behind = -capsules.radius
    run = end[..., 2] - start[..., 2]
    share = np.clip((behind - start[..., 2]) / np.where(run == 0.0, 1.0, run), 0.0, 1.0)
    crossing = start + share[..., None] * (end - start)
    return (
        np.where((start[..., 2] < behind)[..., None], crossing, start),
        np.where((end[..., 2] < behind)[..., None], crossing, end),
    )


def _pixels(
    rows: NDArray[np.int64], columns: NDArray[np.int64], width: int
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """All pixels of windows, about `PIXELS_PER_PASS` at a time:
    place of the window, and place in a flat image.
    """
    if not len(rows):
        return
    wide = columns[:, 1] - columns[:, 0]
    size = wide * (rows[:, 1] - rows[:, 0])
    last = np.cumsum(size)
    groups = np.unique(np.searchsorted(last, np.arange(0, last[-1], PIXELS_PER_PASS)))
    for first, end in zip(groups, [*groups[1:], len(size)], strict=True):
        owner = np.repeat(np.arange(first, end), size[first:end])
        begin = last[first:end] - size[first:end]
        row, column = np.divmod(
            np.arange(len(owner)) + begin[0] - np.repeat(begin, size[first:end]), wide[owner]
        )
        yield owner, (rows[owner, 0] + row) * width + columns[owner, 0] + column
