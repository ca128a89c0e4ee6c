"""A terrain: boxes in the world, with exact heights for labels,
and where a trial on it starts and ends.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from array_api_compat import array_namespace

from saltus.arrays import Array, Floats
from saltus.config import TomlValue, from_table, read_toml
from saltus.errors import ConfigError
from saltus.terrain.boxes import Box, Boxes, Point
from saltus.terrain.columns import Columns

# Ground behind the robot [m]: the rearmost heightmap point at the start is at -0.6
GROUND_START_X = -2.0
FIRST_EDGE_X = (
    1.5  # beyond the camera's reach of 0.5 m from the start, and room for the first bounds
)
RUN_OUT = 4.0  # ground behind the finish [m]: a robot at 2 m/s lands and stops on it
FINISH_AFTER_COURSE = 0.5  # definition of success: this far behind the last edge of a course
FINISH_AFTER_SINGLE = 1.0  # the same behind a single step or gap
TIMING_BEFORE_FIRST_EDGE = (
    0.5  # time runs from here; on flat ground from the start (`Terrain.timing_x`)
)
WIDTH = 4.0
BOTTOM = -1.0  # lower end of all columns, where none of them is low
THICKNESS = 0.6  # of the lowest column, at least: nothing falls through
TRENCH_DEPTH = 0.4  # original
STANCE_M = 0.5  # feet stand 0.2 m ahead of and behind the base, and a trial starts up to 0.2 m off
LEVEL_M = 1e-3
"""Tolerance of the height at the start of somebody's own course: a robot starts upon it."""
_DIGITS = 9  # edges that differ by less than a nanometre are one


@dataclass(frozen=True, kw_only=True)
class Terrain(TomlValue):
    """Boxes in the world frame, in which z = 0 is the ground at the start, at x = `start_x`.

    Raises:
        ConfigError: it has no box.
    """

    kind: str
    """Its family, or a name of one's own."""
    boxes: tuple[Box, ...]
    """They may overlap; the highest counts."""
    finish_x: float
    """The trunk's centre must pass this [m]."""
    start_x: float = 0.0
    params: dict[str, int | float] = field(default_factory=dict, compare=False)
    """The sizes as used, by their names in `TerrainConfig`."""

    def __post_init__(self) -> None:
        if not self.boxes:
            raise ConfigError(f"terrain '{self.kind}' has no boxes: it must have at least one")
        if not math.isfinite(self.start_x) or not math.isfinite(self.finish_x):
            raise ConfigError(
                f"terrain '{self.kind}' starts at {self.start_x} and ends at {self.finish_x}: not "
                "finite"
            )

    @classmethod
    def from_toml(cls, text: str) -> "Terrain":
        """Reads what `to_toml` writes; a box may also be given by its `center` and full `size`."""
        table = read_toml(text)
        if isinstance(boxes := table.get("boxes"), list):
            table["boxes"] = [_by_corners(box, f"boxes[{i}].") for i, box in enumerate(boxes)]
        return from_table(cls, table)

    @cached_property
    def edges_x(self) -> Floats:
        """Every x beyond the start at which the top of a box begins or ends,
        but for the ends of the terrain [m].

        A change of height by zero counts: a course of difficulty 0 has the same edges. Ascending,
        shape (edges,).
        """
        ends: Floats = (
            np.unique(np.round(self.arrays.top_ends, _DIGITS))
            if self.columns is None
            else self.columns.x
        )
        return ends[1:-1][ends[1:-1] > self.start_x]

    @property
    def first_edge_x(self) -> float:
        """The first edge [m]; infinite on flat ground."""
        return float(self.edges_x[0]) if self.edges_x.size else float("inf")

    @property
    def timing_x(self) -> float:
        """Where the time of a trial starts to run: 0.5 m before the first edge.

        The start on flat ground [m].
        """
        return self.first_edge_x - TIMING_BEFORE_FIRST_EDGE if self.edges_x.size else self.start_x

    @property
    def timed(self) -> str:
        """Words that say where the time of a trial starts to run (`timing_x`)."""
        return (
            f"from {TIMING_BEFORE_FIRST_EDGE:g} m before the first edge"
            if self.edges_x.size
            else "from the start"
        )

    @cached_property
    def arrays(self) -> Boxes:
        """The boxes as numpy arrays."""
        return Boxes.of(self.boxes)

    @cached_property
    def columns(self) -> Columns | None:
        """The boxes as columns, where that is what they are:
        level, side by side along x, of one width.
        """
        return Columns.of(self.boxes)

    def height_at(self, x: Array, y: Array) -> Array:
        """Height of the terrain [m] at a place [m]: exact; at an edge, the higher side.

        Beyond its ends and sides the outermost boxes go on.

        Args:
            x: World x, an array of any shape (numpy, torch, or any other of the array API) or a
                number.
            y: World y, an array like `x` or a number.

        Returns:
            An array like `x`.
        """
        if isinstance(x, float | int):
            x = np.asarray(float(x))
        if self.columns is not None:
            return self.columns.height_at(x)
        xp = array_namespace(x)
        aside = xp.full_like(x, float(y)) if isinstance(y, float | int) else y
        heights = self.arrays.like(x).height_at(xp.reshape(x, (-1,)), xp.reshape(aside, (-1,)))
        return xp.reshape(heights, x.shape)


@dataclass(frozen=True, kw_only=True)
class _CentredBox:
    """The form of run logs."""

    center: Point
    size: Point
    pitch: float = 0.0
    yaw: float = 0.0


def check_terrain(terrain: Terrain, where: str) -> Terrain:
    """A terrain that others made, `where` they did,
    if a robot can start on it and stand at its end.

    Raises:
        ConfigError: it cannot.
    """
    start, finish = terrain.start_x, terrain.finish_x
    for name, low, high in (
        ("start", start - STANCE_M, start + STANCE_M),
        ("finish", finish, finish + STANCE_M),
    ):
        if not all(terrain.arrays.covers(x, 0.0) for x in (low, 0.5 * (low + high), high)):
            raise ConfigError(
                f"{where}: no ground under the {name}: boxes must reach from x = {low:g} to "
                f"{high:g} m"
            )
    start_z = float(terrain.height_at(terrain.start_x, 0.0))
    if abs(start_z) > LEVEL_M:
        raise ConfigError(
            f"{where}: the ground at the start is {start_z:g} m high, it must be at 0"
        )
    if terrain.finish_x <= terrain.start_x:
        raise ConfigError(
            f"{where}: finish_x = {terrain.finish_x:g} m, it must be beyond the start at "
            f"{terrain.start_x:g} m"
        )
    return terrain


def _by_corners(box: object, where: str) -> object:
    if not isinstance(box, dict) or "center" not in box:
        return box
    given = from_table(_CentredBox, box, where)
    same = Box.at(given.center, given.size)
    return {"low": list(same.low), "high": list(same.high), "pitch": given.pitch, "yaw": given.yaw}


def build_course(
    kind: str,
    params: Mapping[str, float],
    columns: Sequence[tuple[float, float]],
    *,
    last_top: float,
    finish_behind: float,
) -> Terrain:
    """Puts level boxes after the first edge: start ground, the given ones, ground behind them.

    Args:
        kind: Name of the terrain.
        params: Sizes as used.
        columns: Extent along x and height of each [m]; those of no width, or less than can be told
            at that place, are left out.
        last_top: Height of the ground behind them [m].
        finish_behind: Distance of the finish behind the last edge [m].
    """
    edges = FIRST_EDGE_X + np.concatenate([[0.0], np.cumsum([width for width, _ in columns])])
    kept = [i for i in range(len(columns)) if edges[i + 1] > edges[i]]
    finish = float(edges[-1]) + finish_behind
    ends = [GROUND_START_X, *edges[kept].tolist(), float(edges[-1]), finish + RUN_OUT]
    tops = [0.0, *(float(columns[i][1]) for i in kept), float(last_top)]
    return Terrain(kind=kind, params=dict(params), boxes=boxes_across(ends, tops), finish_x=finish)


def boxes_across(ends: Sequence[float], tops: Sequence[float]) -> tuple[Box, ...]:
    """Level boxes side by side along x and wide in y.

    Args:
        ends: Where the first begins and each ends [m], one more than boxes.
        tops: Height of each [m].
    """
    half, bottom = 0.5 * WIDTH, min(BOTTOM, min(tops) - THICKNESS)
    return tuple(
        Box(low=(low, -half, bottom), high=(high, half, top))
        for low, high, top in zip(ends[:-1], ends[1:], tops, strict=True)
    )
