"""Points sorted into the cells of a window, and windows moved by whole cells:
one law for numpy and torch.

Arrays are clipped by their own method: the compatibility layer's function makes a GPU wait several
times a call.
"""

import math
from typing import NamedTuple

import numpy as np

from saltus.arrays import Array, namespace
from saltus.heightmap.scan.settings import MapSettings

NO_LINE_M = 1e3
"""Height of the lowest line of sight over a cell where there was none [m]."""
LINE_STEP_M, LINE_STEPS = 0.04, 12
"""Along a line of sight, back from its end, heights are taken at so many places, so far apart [m]:
half a metre, about as far as the edge of a step or gap hides the ground behind it. Lines of
neighbouring pixels and images fill the cells between."""


class CellHeights(NamedTuple):
    """Heights [m] that one image, or the standing feet, put into the cells of a robot's map, each
    of shape (batch, side, side).

    Where `count` is 0, the others mean nothing and are finite.
    """

    mean: Array
    variance: Array
    """Variance of the mean [m^2]."""
    high: Array
    low: Array
    count: Array


class HitCells:
    """The cells where a mask is true.

    Numpy works on these alone, as an image hits one in eight. On a GPU, which would wait until they
    are counted, it is all cells.
    """

    def __init__(self, mask: Array) -> None:
        self._mask = mask
        self._places = np.flatnonzero(mask) if isinstance(mask, np.ndarray) else None

    def of(self, plane: Array) -> Array:
        """Values of a plane in them."""
        return plane if self._places is None else plane.reshape(-1).take(self._places)

    def put(self, plane: Array, values: Array) -> Array:
        """The plane with such values in place of its own."""
        if self._places is None:
            return namespace(plane).where(self._mask, values, plane)
        found = plane.copy()
        found.reshape(-1)[self._places] = values
        return found


def window_corner(position: Array, settings: MapSettings) -> Array:
    """First cell of the window around a position:
    whole numbers of `cell_m` from the odometry's origin.

    Shapes (batch, 2 or more) -> (batch, 2).
    """
    xp = namespace(position)
    return xp.astype(xp.round(position[:, :2] / settings.cell_m), xp.int64) - settings.cells // 2


def fine_cell_positions(xy: Array, corner: Array, settings: MapSettings) -> Array:
    """Positions (batch, n, 2) [m] in units of fine cells of the window;
    the centre of the first one is at 0, 0.
    """
    return (
        xy / settings.fine_m
        - 0.5
        - namespace(xy).astype(corner * settings.sub, xy.dtype)[:, None, :]
    )


def cell_centres(corner: Array, settings: MapSettings, like: Array) -> tuple[Array, Array]:
    """Odometry x and y [m] of the window's fine cells,
    of shapes (batch, side, 1) and (batch, 1, side).
    """
    xp = namespace(like)
    steps = xp.arange(settings.side, dtype=like.dtype, device=like.device) + 0.5
    first = xp.astype(corner, like.dtype) * settings.cell_m
    return (
        first[:, 0, None, None] + steps[None, :, None] * settings.fine_m,
        first[:, 1, None, None] + steps[None, None, :] * settings.fine_m,
    )


def sorted_into_cells(
    points: Array,
    variance: Array,
    valid: Array,
    corner: Array,
    settings: MapSettings,
    *,
    extremes: bool = True,
) -> CellHeights:
    """Heights of points (batch, n, 3) in the odometry's frame;
    `variance` [m^2] and `valid` have shape (batch, n).

    Without `extremes`, which take a third of the time, the highest and lowest are the mean.
    """
    xp, side = namespace(points), settings.side
    place = xp.astype(
        xp.floor(fine_cell_positions(points[:, :, :2], corner, settings) + 0.5), xp.int64
    )
    inside = valid & xp.all((place >= 0) & (place < side), axis=-1)
    batch = len(valid)
    robots = xp.arange(batch, dtype=xp.int64, device=points.device)[:, None] * side**2
    index = robots + place[..., 0] * side + place[..., 1]
    size = batch * side**2
    index, z, variance = _chosen(inside, size, index, points[:, :, 2], variance)
    sums = [_added(index, value, size) for value in (xp.ones_like(z), z, variance)]
    number, total, spread = (value.reshape(batch, side, side) for value in sums)
    some = number.clip(1.0, math.inf)  # numpy takes twice as long with no upper limit
    mean, each = total / some, spread / some
    shared = settings.shared_noise
    high = low = mean
    if extremes:
        hit = number > 0.0
        found = [_farthest(index, z, size, start) for start in (-math.inf, math.inf)]
        high, low = (xp.where(hit, value.reshape(batch, side, side), 0.0) for value in found)
    variance = each * (shared + (1.0 - shared) / some)
    return CellHeights(mean=mean, variance=variance, high=high, low=low, count=number)


def lowest_lines(
    points: Array,
    viewpoint: Array,
    start_m: Array,
    valid: Array,
    corner: Array,
    settings: MapSettings,
) -> Array:
    """Height of the lowest line of sight over each cell [m], shape (batch, side, side).

    `NO_LINE_M` where there is none. But for errors, and edges within a cell, ground is not higher:
    a ray that reached its end met nothing before.

    Args:
        points: Where lines end, in the odometry's frame [m], shape (batch, n, 3).
        viewpoint: Where they begin, shape (batch, n, 3) or (batch, 1, 3).
        start_m: Length at the end of each line, on the level, that is left out, as the surface may
            be there by the depth's error [m], shape (batch, n).
        valid: True where there is a point, shape (batch, n).
        corner: First cell of the window, see `window_corner`.
        settings: Of the map.
    """
    xp, batch, side = namespace(points), len(valid), settings.side
    # Points come last: numpy adds to long rows in half the time
    end = xp.matrix_transpose(fine_cell_positions(points[..., :2], corner, settings)) + 0.5
    away, height = xp.matrix_transpose(viewpoint - points), points[..., 2]
    if isinstance(points, np.ndarray) and batch == 1:  # what a camera sees is not all in the window
        reach = (start_m + LINE_STEPS * LINE_STEP_M) / settings.fine_m
        near = np.flatnonzero(valid & np.all((end > -reach) & (end < side + reach), axis=1))
        end, away, height, start_m, valid = (
            values.take(near, axis=-1) for values in (end, away, height, start_m, valid)
        )
    length = ((away[:, 0] ** 2 + away[:, 1] ** 2) ** 0.5).clip(1e-3, None)
    steps = LINE_STEP_M * xp.arange(LINE_STEPS, dtype=points.dtype, device=points.device)
    share = (start_m[:, None, :] + steps[:, None]) / length[:, None, :]
    back = away / settings.fine_m
    row, column = (xp.floor(end[:, None, axis] + share * back[:, None, axis]) for axis in (0, 1))
    inside = valid[:, None, :] & (share < 1.0)
    inside = inside & (row >= 0) & (row < side) & (column >= 0) & (column < side)
    robots = xp.arange(batch, dtype=xp.int64, device=points.device)[:, None, None] * side**2
    index = robots + xp.astype(row * side + column, xp.int64)
    height = height[:, None, :] + share * away[:, None, 2]
    size = batch * side**2
    index, height = _chosen(inside, size, index, height)
    found = _farthest(index, height, size, math.inf)
    return found.clip(None, NO_LINE_M).reshape(batch, side, side)


def move_window(values: Array, by: Array, new: float) -> Array:
    """Values (batch, side, side) of a window that goes on by whole fine cells (batch, 2);
    `new` where it sees more.
    """
    xp = namespace(values)
    batch, side = values.shape[0], values.shape[1]
    if isinstance(values, np.ndarray):  # blocks are copied in a tenth of the time
        found = np.full_like(values, new)
        for robot, (down, right) in enumerate(by.clip(-side, side).tolist()):
            (to_row, from_row), (to_column, from_column) = (
                _overlap(down, side),
                _overlap(right, side),
            )
            found[robot, to_row, to_column] = values[robot, from_row, from_column]
        return found
    steps = xp.arange(side, dtype=xp.int64, device=values.device)
    rows, columns = steps[None, :] + by[:, :1], steps[None, :] + by[:, 1:]
    robots = xp.arange(batch, dtype=xp.int64, device=values.device)[:, None, None]
    taken = values[
        robots, rows.clip(0, side - 1)[:, :, None], columns.clip(0, side - 1)[:, None, :]
    ]
    inside = ((rows >= 0) & (rows < side))[:, :, None] & ((columns >= 0) & (columns < side))[
        :, None, :
    ]
    return xp.where(inside, taken, new)


def _overlap(by: int, side: int) -> tuple[slice, slice]:
    """Places along one side that stay in a window that goes on by so many:
    the new ones, and the old ones.
    """
    return slice(max(0, -by), side - max(0, by)), slice(max(0, by), side - max(0, -by))


def sample_bilinear(values: Array, place: Array) -> Array:
    """Bilinear values at places (batch, n, 2) in units of cells, held at the border.

    Shape (batch, n). Places of one batch serve all.
    """
    xp, side = namespace(values), values.shape[1]
    place = place.clip(0.0, side - 1.0)
    first = xp.floor(place).clip(0.0, side - 2.0)
    share = place - first
    first = xp.astype(first, xp.int64)
    robots = xp.arange(values.shape[0], dtype=xp.int64, device=values.device)[:, None]
    s, t = share[..., 0], share[..., 1]
    corner = (robots * side + first[..., 0]) * side + first[..., 1]
    flat = xp.reshape(values, (-1,))
    near = flat[corner] * (1.0 - t) + flat[corner + 1] * t
    far = flat[corner + side] * (1.0 - t) + flat[corner + side + 1] * t
    return near * (1.0 - s) + far * s


def _chosen(inside: Array, size: int, index: Array, *values: Array) -> list[Array]:
    """Places and values of what is inside an array of `size`, each in one row.

    Numpy leaves out the rest. On a GPU, which would wait until it is counted, the rest goes to
    places from `size` on, far apart: additions to one place would wait for each other.
    """
    xp = namespace(inside)
    inside, index, *others = [each.reshape(-1) for each in (inside, index, *values)]
    if isinstance(inside, np.ndarray):
        chosen = np.flatnonzero(inside)
        return [each.take(chosen) for each in (index, *others)]
    spare = xp.arange(len(index), dtype=xp.int64, device=index.device) % size
    return [xp.where(inside, index, size + spare), *others]


def _added(index: Array, values: Array, size: int) -> Array:
    """Sums of the values that come to each of `size` places; places behind these are left out."""
    if isinstance(values, np.ndarray):
        return np.bincount(index, values, size).astype(values.dtype)
    return values.new_zeros(2 * size).index_add_(0, index, values)[:size]


def _farthest(index: Array, values: Array, size: int, start: float) -> Array:
    """Highest value that comes to each place where `start` is minus infinity, lowest where it is
    infinity; `start` where none comes.
    """
    if isinstance(values, np.ndarray):
        found = np.full(size, start, values.dtype)
        (np.maximum if start < 0.0 else np.minimum).at(found, index, values)
        return found
    kind = "amax" if start < 0.0 else "amin"
    return values.new_full((2 * size,), start).scatter_reduce_(0, index, values, kind)[:size]
