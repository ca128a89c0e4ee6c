"""The boxes of a terrain as triangles."""

import itertools

import numpy as np
from numpy.typing import NDArray

from saltus.terrain.terrain import Terrain

_CORNERS = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
# two triangles a face, corners counted as bits x y z, outward by the right-hand rule
_TRIANGLES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


def box_triangles(terrain: Terrain) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Vertices [m], world frame, shape (8 boxes, 3), and corners of triangles, shape (12 boxes, 3)."""
    vertices = terrain.box_center[:, None, :] + _CORNERS * terrain.box_size[:, None, :]
    first = 8 * np.arange(len(vertices))
    triangles = first[:, None, None] + _TRIANGLES
    return vertices.reshape(-1, 3).astype(np.float32), triangles.reshape(-1, 3).astype(np.uint32)
