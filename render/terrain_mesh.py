"""The surface of a terrain as triangles."""

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.terrain.boxes import Boxes
from saltus.terrain.columns import Columns
from saltus.terrain.terrain import Terrain

_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
# Seen from outside
_FACES = (
    (0, 1, 3, 2),
    (4, 6, 7, 5),
    (0, 4, 5, 1),
    (2, 3, 7, 6),
    (0, 2, 6, 4),
    (1, 5, 7, 3),
)


def terrain_triangles(terrain: Terrain) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """The outer surface of columns, without walls between columns of one height.

    Else all faces of all boxes.

    Returns:
        Vertices [m], world frame, shape (4 faces, 3), and corners of triangles, shape (2 faces, 3).
    """
    faces = (
        _box_faces(terrain.arrays) if terrain.columns is None else _column_faces(terrain.columns)
    )
    vertices = faces.reshape(-1, 3)
    first = np.arange(0, len(vertices), 4)
    triangles = first[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    return vertices.astype(np.float32), triangles.reshape(-1, 3).astype(np.uint32)


def _box_faces(boxes: Boxes) -> Floats:
    """Six faces of each box, shape (n, 4, 3)."""
    corners = boxes.center[:, None] + (_CORNERS * boxes.half_size[:, None]) @ boxes.rotation.mT
    return np.asarray(corners[:, _FACES].reshape(-1, 4, 3))


def _column_faces(columns: Columns) -> Floats:
    """Treads, risers, sides, ends and bottom, shape (n, 4, 3)."""
    x, top, bottom = columns.x, columns.top, columns.bottom
    sides = right, left = -0.5 * columns.width, 0.5 * columns.width
    before = np.concatenate([[bottom], top])  # on the near side of every wall, and beyond it
    beyond = np.concatenate([top, [bottom]])
    wall = np.nonzero(before != beyond)[0]
    under = np.full(1, bottom)
    faces = [
        _faces(x[:-1], x[1:], sides, top, top),
        _across(x[wall], sides, before[wall], beyond[wall]),
        *(_along(x[:-1], x[1:], y, top, bottom) for y in (right, left)),
        _faces(x[:1], x[-1:], sides, under, under),
    ]
    return np.concatenate(faces)


def _faces(
    first: Floats, last: Floats, y: tuple[float, float], z_first: Floats, z_last: Floats
) -> Floats:
    """Rectangles over the whole width between two x, shape (n, 4, 3)."""
    return np.stack(
        [_points(first, y[0], z_first), _points(last, y[0], z_last), _points(last, y[1], z_last),
         _points(first, y[1], z_first)], axis=1,
    )  # fmt: skip


def _across(x: Floats, y: tuple[float, float], low: Floats, high: Floats) -> Floats:
    """Upright rectangles across the course, shape (n, 4, 3)."""
    return _faces(x, x, y, low, high)


def _along(first: Floats, last: Floats, y: float, top: Floats, bottom: float) -> Floats:
    """Upright rectangles along the course, shape (n, 4, 3)."""
    low = np.full_like(top, bottom)
    return np.stack(
        [
            _points(first, y, low),
            _points(last, y, low),
            _points(last, y, top),
            _points(first, y, top),
        ],
        axis=1,
    )


def _points(x: Floats, y: float, z: Floats) -> Floats:
    return np.stack([x, np.full_like(x, y), z], axis=-1)
