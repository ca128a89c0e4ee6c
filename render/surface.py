"""The surface of a terrain as triangles."""

import numpy as np
from numpy.typing import NDArray

from saltus.errors import SaltusError
from saltus.terrain.terrain import BOTTOM, Terrain
from saltus.wire.messages import Floats


def terrain_triangles(terrain: Terrain) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """The outer surface: treads, risers, sides, ends and bottom; no walls between columns of one height.

    Returns:
        Vertices [m], world frame, shape (4 faces, 3), and corners of triangles, shape (2 faces, 3).

    Raises:
        SaltusError: the terrain is not one that can be drawn.
    """
    check_terrain(terrain)
    x, top = terrain.column_x, terrain.column_top
    right, left = -0.5 * terrain.width, 0.5 * terrain.width
    before = np.concatenate([[BOTTOM], top])  # on the near side of every wall, and beyond it
    beyond = np.concatenate([top, [BOTTOM]])
    wall = np.nonzero(before != beyond)[0]
    faces = [
        _faces(x[:-1], x[1:], (right, left), top, top),
        _across(x[wall], (right, left), before[wall], beyond[wall]),
        *(_along(x[:-1], x[1:], y, top) for y in (right, left)),
        _faces(x[:1], x[-1:], (right, left), np.array([BOTTOM]), np.array([BOTTOM])),
    ]
    vertices = np.concatenate(faces).reshape(-1, 3)
    first = np.arange(0, len(vertices), 4)
    triangles = first[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    return vertices.astype(np.float32), triangles.reshape(-1, 3).astype(np.uint32)


def check_terrain(terrain: Terrain) -> None:
    """Refuses what no back end can draw.

    Raises:
        SaltusError: a size is not finite, or the boundaries of the columns are not ascending.
    """
    for name, value in (("column_x", terrain.column_x), ("column_top", terrain.column_top), ("width", terrain.width)):
        wrong = np.flatnonzero(~np.isfinite(value))
        if wrong.size:
            raise SaltusError(
                f"terrain '{terrain.kind}': {name} is {np.ravel(value)[wrong[0]]} at place {wrong[0]}; "
                "every size of a terrain must be a finite number of metres"
            )
    if not (np.diff(terrain.column_x) > 0.0).all() or len(terrain.column_top) != len(terrain.column_x) - 1:
        raise SaltusError(
            f"terrain '{terrain.kind}': {len(terrain.column_x)} boundaries of {len(terrain.column_top)} columns; "
            "there must be one more than columns, in ascending order"
        )


def _faces(first: Floats, last: Floats, y: tuple[float, float], z_first: Floats, z_last: Floats) -> Floats:
    """Rectangles over the whole width between two x, shape (n, 4, 3)."""
    return np.stack(
        [_points(first, y[0], z_first), _points(last, y[0], z_last), _points(last, y[1], z_last),
         _points(first, y[1], z_first)], axis=1,
    )  # fmt: skip


def _across(x: Floats, y: tuple[float, float], low: Floats, high: Floats) -> Floats:
    """Upright rectangles across the course, shape (n, 4, 3)."""
    return _faces(x, x, y, low, high)


def _along(first: Floats, last: Floats, y: float, top: Floats) -> Floats:
    """Upright rectangles along the course, shape (n, 4, 3)."""
    low = np.full_like(top, BOTTOM)
    return np.stack(
        [_points(first, y, low), _points(last, y, low), _points(last, y, top), _points(first, y, top)], axis=1
    )


def _points(x: Floats, y: float, z: Floats) -> Floats:
    return np.stack([x, np.full_like(x, y), z], axis=-1)
