"""Many terrains at once, one for each robot of a batch."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from array_api_compat import array_namespace
from numpy.typing import NDArray

from saltus.terrain.terrain import Floats, Terrain

SPARE_DEPTH = -100.0  # a box that a terrain does not need lies this deep below its end, out of everything's way [m]
SPARE_SIZE = 0.02  # [m]


@dataclass(frozen=True)
class TerrainStack:
    """Terrain `i` belongs to robot `i`."""

    terrains: Sequence[Terrain]

    @cached_property
    def columns(self) -> int:
        """Number of columns of the terrain that has the most."""
        return max(len(terrain.column_top) for terrain in self.terrains)

    @cached_property
    def walls(self) -> Floats:
        """Boundaries between columns [m], padded with infinity, shape (robots, columns - 1)."""
        return np.stack([_padded(t.column_x[1:-1], self.columns - 1, np.inf) for t in self.terrains])

    @cached_property
    def tops(self) -> Floats:
        """Heights of columns [m], shape (robots, columns)."""
        return np.stack([_padded(t.column_top, self.columns, 0.0) for t in self.terrains])

    @cached_property
    def finish_x(self) -> Floats:
        """[m], shape (robots,)."""
        return np.array([terrain.finish_x for terrain in self.terrains])

    def height_at(self, x: Any) -> Any:
        """Height of each robot's terrain [m], as `Terrain.height_at`.

        Args:
            x: World x, numpy or torch, shape (robots, points).

        Returns:
            Shape (robots, points).
        """
        xp = array_namespace(x)
        walls = xp.astype(xp.asarray(self.walls, device=x.device), x.dtype)[:, None, :]
        tops = xp.astype(xp.asarray(self.tops, device=x.device), x.dtype)
        behind = xp.sum(xp.astype(x[..., None] > walls, xp.int64), axis=-1)
        ahead = xp.sum(xp.astype(x[..., None] >= walls, xp.int64), axis=-1)
        return xp.maximum(xp.take_along_axis(tops, behind, axis=1), xp.take_along_axis(tops, ahead, axis=1))

    def boxes(self, columns: int) -> tuple[Floats, Floats]:
        """Centres and full sizes of boxes [m], each of shape (robots, columns, 3)."""
        centers = np.zeros((len(self.terrains), columns, 3))
        sizes = np.full_like(centers, SPARE_SIZE)
        for i, terrain in enumerate(self.terrains):
            used = len(terrain.column_top)
            centers[i] = (terrain.column_x[-1], 0.0, SPARE_DEPTH)
            centers[i, :used], sizes[i, :used] = terrain.box_center, terrain.box_size
        return centers, sizes


def _padded(values: NDArray[np.float64], length: int, fill: float) -> Floats:
    return np.concatenate([values, np.full(length - len(values), fill)])
