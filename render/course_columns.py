"""Depth of a course of columns in closed form: no ray is cast.

Seen along the course, in the plane of x and z, its surface is one line of treads and risers. From
above the ground the direction of a ray alone says which of them it meets: their visible ends cut
all directions, from straight back over straight down to straight ahead, into one sector each. A
column of pixels sweeps through the sectors in order, and crosses each end at a row that is linear
in the column. Within a face the inverse depth is linear in the pixel.
"""

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.depth import Intrinsics
from saltus.terrain.columns import Columns

ABOVE_M = 0.01
"""A camera that is nearer to ground, walls or the course's sides may be within them by rounding."""
LEAST_M = 1e-9
"""Least distance along the course from an end: one that is nearer is taken for straight below."""


class SeenColumns:
    """Columns of a course's ground as a camera sees them."""

    def __init__(self, columns: Columns, camera: Intrinsics) -> None:
        self._columns, self._height = columns, camera.height
        self._end_x = np.repeat(columns.x, 2)[1:-1]
        self._end_z = np.repeat(columns.top, 2)
        self._across = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
        self._down = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
        self._fy, self._cy = camera.fy, camera.cy - 0.5
        self._half_width = 0.5 * columns.width
        left, right, upper, lower = (
            side[i] for side in (self._across, self._down) for i in (0, -1)
        )
        self._corners = np.array([[left, right] * 2, [upper] * 2 + [lower] * 2, [1.0] * 4])

    def depth(self, origin: Floats, rotation: Floats) -> NDArray[np.float32]:
        """Depth from n cameras that `sees` [m], infinite beside the course.

        Args:
            origin: Optical centres [m], world frame, shape (n, 3).
            rotation: Camera to world, shape (n, 3, 3).

        Returns:
            Shape (n, height, width).
        """
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            begins, per_column = self._rows(origin, rotation)
            left, right = (begins + per_column * side for side in self._across[[0, -1]])
            first, last = self._in_view(np.maximum(left, right), np.minimum(left, right))
            across = self._across[:, None]
            rows = begins[:, None, first:last] + per_column[:, None, first:last] * across
            ends = np.zeros((*rows.shape[:2], last - first + 2), np.int32)
            ends[..., -1] = self._height
            np.clip(np.ceil(rows), 0, self._height, out=ends[..., 1:-1], casting="unsafe")
            np.maximum.accumulate(ends, axis=-1, out=ends)
            tall = ends[..., 1:] - ends[..., :-1]
            planes = self._planes(origin, rotation)[:, :, first : last + 1].astype(np.float32)
            across, down = across.astype(np.float32), self._down.astype(np.float32)
            strips = np.empty(tall.shape, np.complex64)
            strips.real = planes[:, :1] * across + planes[:, 2:]
            strips.imag = planes[:, 1:2]
            image = np.repeat(strips.reshape(-1), tall.reshape(-1))
            image = image.reshape(*tall.shape[:2], self._height)
            depth = image.imag * down
            depth += image.real
            np.divide(1.0, depth, out=depth)
            side = rotation[:, 1].astype(np.float32)[:, :, None]
            place = side[:, :1] * across + side[:, 2:] + side[:, 1:2] * down
            place *= depth
            place += origin[:, 1, None, None].astype(np.float32)
            depth[np.abs(place, out=place) > self._half_width] = np.inf
        return np.ascontiguousarray(depth.swapaxes(1, 2))

    def sees(self, origin: Floats, rotation: Floats) -> NDArray[np.bool_]:
        """Cameras above the course that sweep it from ahead to back, bool, shape (n,).

        Others may be within it, lie on their sides, or look over their backs.
        """
        x, y, z = origin.T
        columns = self._columns
        over = (x > columns.x[0]) & (x < columns.x[-1]) & (abs(y) < self._half_width - ABOVE_M)
        for beside in (-ABOVE_M, 0.0, ABOVE_M):  # a wall that is as near
            column = np.searchsorted(columns.x, x + beside) - 1
            over &= z > columns.top.take(column, mode="clip") + ABOVE_M
        corners = rotation @ self._corners
        ahead, up = corners[:, 0], corners[:, 2]
        turns = ahead * rotation[:, 2, 1:2] < up * rotation[:, 0, 1:2]
        upper_and_lower = (len(x), 2, 2)
        forward = (ahead > 0.0).reshape(upper_and_lower).all(axis=-1)
        below = (up < 0.0).reshape(upper_and_lower).all(axis=-1)
        sweeps = turns.all(axis=1) & (forward | below).all(axis=1)
        return over & sweeps & (rotation[:, 2, 1] < 0.0)

    def _rows(self, origin: Floats, rotation: Floats) -> tuple[Floats, Floats]:
        """Row at which each end is crossed, from the last end ahead to the last one behind:
        of a column straight ahead, and by how much more to the right; shape (n, ends).
        """
        ahead, up = self._end_x - origin[:, :1], self._end_z - origin[:, 2:]
        is_ahead = ahead > 0.0
        slope = up / np.maximum(np.abs(ahead), LEAST_M)
        # What lies behind a higher end is not seen
        forth = np.maximum.accumulate(np.where(is_ahead, slope, -np.inf), axis=1)
        back = np.maximum.accumulate(np.where(is_ahead, -np.inf, slope)[:, ::-1], axis=1)[:, ::-1]
        slope, sign = np.where(is_ahead, forth, back), np.where(is_ahead, 1.0, -1.0)
        turned = sign[:, None] * rotation[:, 2, :, None] - slope[:, None] * rotation[:, 0, :, None]
        right, down, forward = turned[:, 0], turned[:, 1], turned[:, 2]
        # Some are beyond straight up or straight down of a column, which ends before them
        crossed, below = down < 0.0, (sign < 0.0) | (slope < 0.0)
        beyond = np.where(below, np.inf, -np.inf)
        scale = -self._fy / down
        begins = np.where(crossed, self._cy + forward * scale, beyond)
        per_column = np.where(crossed, right * scale, 0.0)
        return begins[:, ::-1], per_column[:, ::-1]

    def _in_view(self, lowest: Floats, highest: Floats) -> tuple[int, int]:
        """Ends, from the first to before the last, of which some image shows one of both sides.

        Of the lowest and of the highest row of each end in each image, shape (n, ends).
        """
        below_top = np.append((lowest > 0.0).any(axis=0), True)
        above_bottom = np.append(True, (highest <= self._height - 1.0).any(axis=0))
        return int(below_top.argmax()), len(above_bottom) - 1 - int(above_bottom[::-1].argmax())

    def _planes(self, origin: Floats, rotation: Floats) -> Floats:
        """Inverse depth of each face by pixel: across, down, straight ahead; shape (n, 3, faces).

        From what is beyond the last end ahead to what is beyond the last one behind: both are 0.
        """
        columns, count = self._columns, 2 * len(self._columns.top)
        planes = np.zeros((len(origin), 3, count + 1))
        treads = columns.top - origin[:, 2:]
        risers = columns.x[1:-1] - origin[:, :1]
        planes[:, :, 1::2] = rotation[:, 2, :, None] / treads[:, None]
        planes[:, :, 2:-1:2] = rotation[:, 0, :, None] / risers[:, None]
        return planes[:, :, ::-1]
