"""A terrain as columns across the course: exact heights for labels, boxes for physics and cameras."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace
from numpy.typing import NDArray

from saltus.config import TerrainKind

Floats = NDArray[np.float64]

GROUND_START_X = -2.0  # ground behind the robot [m]: the rearmost heightmap point at the start is at -0.6
FIRST_EDGE_X = 1.5  # beyond the camera's reach of 0.5 m from the start, and room for the first bounds
RUN_OUT = 4.0  # ground behind the finish [m]: a robot at 2 m/s lands and stops on it
FINISH_AFTER_COURSE = 0.5  # definition of success: this far behind the last edge of a course
FINISH_AFTER_SINGLE = 1.0  # the same behind a single step or gap
TIMING_BEFORE_FIRST_EDGE = 0.5  # time runs from here
WIDTH = 4.0
BOTTOM = -1.0  # lower end of all columns; thick enough that nothing falls through
TRENCH_DEPTH = 0.4  # original


@dataclass(frozen=True, kw_only=True, eq=False)
class Terrain:
    """Columns side by side along x, each of constant height, as wide as the course.

    World frame: z = 0 is the ground on which the robot starts, at x = `start_x`.
    """

    kind: TerrainKind
    params: Mapping[str, float]
    """The sizes as used, by their names in `TerrainConfig`."""
    column_x: Floats
    """Boundaries of the columns, ascending [m], shape (n + 1,)."""
    column_top: Floats
    """Height of each column [m], shape (n,)."""
    edges_x: Floats
    """Every x at which the height changes, ascending [m]; a change of size zero counts, so that a terrain of
    difficulty 0 has the same course. Shape (edges,)."""
    finish_x: float
    """The trunk's centre must pass this [m]."""
    start_x: float = 0.0
    width: float = WIDTH

    @property
    def first_edge_x(self) -> float:
        """The first edge [m]; infinite on flat ground."""
        return float(self.edges_x[0]) if self.edges_x.size else float("inf")

    @property
    def last_edge_x(self) -> float:
        """The last edge [m]; minus infinity on flat ground."""
        return float(self.edges_x[-1]) if self.edges_x.size else float("-inf")

    @property
    def timing_x(self) -> float:
        """Where the time of a trial starts to run: 0.5 m before the first edge; the start on flat ground [m]."""
        return self.first_edge_x - TIMING_BEFORE_FIRST_EDGE if self.edges_x.size else self.start_x

    @property
    def box_center(self) -> Floats:
        """Centre of the box of each column [m], world frame, shape (n, 3)."""
        x = 0.5 * (self.column_x[1:] + self.column_x[:-1])
        return np.stack([x, np.zeros_like(x), 0.5 * (self.column_top + BOTTOM)], axis=-1)

    @property
    def box_size(self) -> Floats:
        """Full edge lengths of the box of each column [m], shape (n, 3)."""
        x = np.diff(self.column_x)
        return np.stack([x, np.full_like(x, self.width), self.column_top - BOTTOM], axis=-1)

    def height_at(self, x: Any) -> Any:
        """Height of the terrain [m] at `x` [m]: exact; at an edge, the higher side.

        Beyond both ends the outermost columns go on.

        Args:
            x: World x, an array of any shape (numpy, torch, or any other of the array API) or a number.

        Returns:
            An array like `x`.
        """
        if isinstance(x, float | int):
            x = np.asarray(float(x))
        xp = array_namespace(x)
        # The dtype of x decides: a boundary is compared in the precision in which x is known.
        walls = xp.astype(xp.asarray(self.column_x[1:-1], device=x.device), x.dtype)
        tops = xp.astype(xp.asarray(self.column_top, device=x.device), x.dtype)
        behind = xp.sum(xp.astype(x[..., None] > walls, xp.int64), axis=-1)  # column, if a wall counts backward
        ahead = xp.sum(xp.astype(x[..., None] >= walls, xp.int64), axis=-1)  # column, if a wall counts forward
        shape = tuple(x.shape)
        left = xp.take(tops, xp.reshape(behind, (-1,)), axis=0)
        right = xp.take(tops, xp.reshape(ahead, (-1,)), axis=0)
        return xp.reshape(xp.maximum(left, right), shape)


def build(
    kind: TerrainKind,
    params: Mapping[str, float],
    *,
    widths: Sequence[float],
    tops: Sequence[float],
    last_top: float,
    finish_behind: float,
) -> Terrain:
    """Puts columns after the first edge: start ground, the given columns, ground behind them.

    Args:
        kind: Name of the terrain.
        params: Sizes as used.
        widths: Extent along x of each column [m]; columns of no width are left out.
        tops: Height of each [m].
        last_top: Height of the ground behind them [m].
        finish_behind: Distance of the finish behind the last edge [m].
    """
    edges = FIRST_EDGE_X + np.concatenate([[0.0], np.cumsum(np.asarray(widths, dtype=np.float64))])
    finish = float(edges[-1]) + finish_behind
    kept = [i for i, width in enumerate(widths) if width > 0.0]
    starts = [GROUND_START_X, *(edges[i] for i in kept), edges[-1], finish + RUN_OUT]
    return Terrain(
        kind=kind,
        params=dict(params),
        column_x=np.asarray(starts, dtype=np.float64),
        column_top=np.asarray([0.0, *(tops[i] for i in kept), last_top], dtype=np.float64),
        edges_x=np.unique(edges),
        finish_x=finish,
    )
