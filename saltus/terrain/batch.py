"""Terrains of training: thousands at once, each drawn from a kind, a difficulty and random numbers, as boxes.

The sizes follow the laws of difficulty of `saltus.terrain.curriculum`; what a course repeats, and where it begins, is
drawn, so that nothing can be learnt by heart. Courses are longer than those of `saltus.terrain`: several trenches
instead of one, several steps up.
"""

from dataclasses import dataclass

from saltus.arrays import Array, namespace
from saltus.config import TerrainKind
from saltus.terrain.boxes import Boxes
from saltus.terrain.curriculum import TABLE
from saltus.terrain.terrain import TRENCH_DEPTH, WIDTH

KINDS: tuple[TerrainKind, ...] = ("flat", "stairs", "stepping_stones", "step", "gap")
"""A kind is its place in this order."""

COLUMNS = 18
"""Start, up to 16 treads or stones, and ground behind them: what a robot passes in ten jumps."""
BOXES = COLUMNS + 1
"""With the floor of the trenches."""
DRAWS = 8 + COLUMNS
"""Uniform random numbers that one course takes."""

FIRST_EDGE_X = (0.6, 1.6)  # both within reach of the first jump and beyond what the robot sees at the start
STAIR_RUN_M = (0.23, 0.37)  # original
STONE_M = (0.45, 0.60)  # around the 0.5 m of the original
PLATFORM_M = (1.6, 2.6)  # one to three jumps between single obstacles
REPEATS = {"flat": 0, "stairs": 16, "stepping_stones": 15, "step": 3, "gap": 4}
_SMALLEST_GAP_SHARE = 0.2  # where gaps differ within a course
_BEHIND_START = 4.0  # ground behind the robot [m]
_RUN_OUT = 6.0  # ground behind the last edge [m]
_THICKNESS = 2.0  # of a box [m]: nothing falls through
_SPARE_TOP = -50.0  # columns that a course does not need lie down there [m]
_FINISH_BEHIND = 1.0  # of the last edge [m]; the trunk is then wholly over it
_FLAT_FINISH_X = 8.0  # ten jumps of 0.8 m


@dataclass(frozen=True, kw_only=True, eq=False)
class Courses:
    """Columns that may overlap; the highest at a place is the ground. Arrays with a leading dimension of robots."""

    low: Array
    """Where each column begins [m], world x, shape (n, COLUMNS)."""
    high: Array
    """Where it ends [m]."""
    top: Array
    """Its height [m]; columns that a course does not need lie far below."""
    finish_x: Array
    """End of the course [m], shape (n,)."""
    slope: Array
    """Length of way, up and along, for each metre ahead, on average over the course; shape (n,)."""
    turn: Array | None = None
    """Pitch and yaw of the columns about their centres [rad], shape (n, COLUMNS, 2); None where all are level."""

    def height_at(self, x: Array, y: Array) -> Array:
        """Ground at world x and y [m], the higher side of an edge; shapes (n, points). Level columns reach any y."""
        if self.turn is not None:
            return self.boxes().height_at(x, y)
        xp = namespace(x)
        inside = (x[..., None] >= self.low[:, None, :]) & (x[..., None] <= self.high[:, None, :])
        floor = xp.zeros_like(self.top[:, None, :]) - TRENCH_DEPTH
        return xp.max(xp.where(inside, self.top[:, None, :], floor), axis=-1)

    def boxes(self) -> Boxes:
        """Columns and floor, arrays of shape (n, BOXES, ...)."""
        xp = namespace(self.low)
        low = xp.concat([self.low, self.low[:, :1]], axis=-1)
        high = xp.concat([self.high, self.high[:, -1:]], axis=-1)
        top = xp.concat([self.top, xp.zeros_like(self.top[:, :1]) - TRENCH_DEPTH], axis=-1)
        half = xp.zeros_like(low) + 0.5 * _THICKNESS
        return Boxes(
            center=xp.stack([0.5 * (low + high), xp.zeros_like(low), top - half], -1),
            half_size=xp.stack([0.5 * (high - low), xp.zeros_like(low) + 0.5 * WIDTH, half], -1),
            turn=None if self.turn is None else xp.concat([self.turn, xp.zeros_like(self.turn[:, :1])], axis=1),
        )


def draw_courses(kind: Array, difficulty: Array, draws: Array) -> Courses:
    """Makes one course for each robot.

    Args:
        kind: Place in `KINDS`, integers, shape (n,).
        difficulty: 0 to 1, shape (n,).
        draws: Uniform in [0, 1), shape (n, DRAWS).
    """
    xp = namespace(draws)
    index = xp.cumulative_sum(xp.ones_like(draws[:, :COLUMNS]), axis=-1) - 1.0  # (n, COLUMNS): 0, 1, 2, ...
    start = _between(FIRST_EDGE_X, draws[:, 0])
    rise, gap = _sizes(kind, difficulty)
    length = _lengths(kind, draws)
    count = _chosen(kind, draws[:, 0], [float(REPEATS[name]) for name in KINDS])[:, None]
    gaps = gap[:, None] * _gap_shares(kind, draws)
    used = (index >= 1.0) & (index <= count)
    # Column k > 0 begins behind the gaps and columns before it.
    pitch = xp.where(used, length[:, None] + gaps, xp.zeros_like(gaps))
    ends = start[:, None] + xp.cumulative_sum(pitch, axis=-1)
    low = xp.where(index == 0.0, xp.zeros_like(ends) - _BEHIND_START, ends - length[:, None])
    last = index >= count
    level_end = xp.where(count > 0.0, xp.zeros_like(ends), xp.zeros_like(ends) + _FLAT_FINISH_X)
    high = xp.where(last, xp.maximum(ends, level_end) + _RUN_OUT, ends)
    top = xp.where(index > count, xp.zeros_like(low) + _SPARE_TOP, rise[:, None] * index)
    last_edge = ends[:, -1] - xp.where(count[:, 0] > 0.0, length, xp.zeros_like(length))
    finish = xp.where(count[:, 0] > 0.0, last_edge + _FINISH_BEHIND, xp.zeros_like(start) + _FLAT_FINISH_X)
    way = xp.clip(last_edge - start, 0.3, None)
    return Courses(low=low, high=high, top=top, finish_x=finish, slope=1.0 + rise * count[:, 0] / way)


def _sizes(kind: Array, difficulty: Array) -> tuple[Array, Array]:
    """Rise from column to column and width of trenches [m], each of shape (n,)."""
    rises = [_law("stairs", "rise_m"), _law("step", "height_m")]
    gaps = [_law("stepping_stones", "gap_m"), _law("gap", "gap_m")]
    rise_base, rise_slope = (_chosen(kind, difficulty, [0.0, rises[0][i], 0.0, rises[1][i], 0.0]) for i in (0, 1))
    gap_base, gap_slope = (_chosen(kind, difficulty, [0.0, 0.0, gaps[0][i], 0.0, gaps[1][i]]) for i in (0, 1))
    return rise_base + rise_slope * difficulty, gap_base + gap_slope * difficulty


def _law(kind: TerrainKind, size: str) -> tuple[float, float]:
    law = TABLE[kind][size]
    return law.base or 0.0, law.slope


def _lengths(kind: Array, draws: Array) -> Array:
    """Length of a column along x [m], shape (n,)."""
    ranges = [PLATFORM_M, STAIR_RUN_M, STONE_M, PLATFORM_M, PLATFORM_M]
    low = _chosen(kind, draws[:, 1], [r[0] for r in ranges])
    high = _chosen(kind, draws[:, 1], [r[1] for r in ranges])
    return low + (high - low) * draws[:, 1]


def _gap_shares(kind: Array, draws: Array) -> Array:
    """Width of each trench as a share of the widest: half of the courses of stones have equal ones. Shape (n, k)."""
    xp = namespace(draws)
    drawn = _SMALLEST_GAP_SHARE + (1.0 - _SMALLEST_GAP_SHARE) * draws[:, 8:]
    differ = (kind == KINDS.index("stepping_stones")) & (draws[:, 2] < 0.5)
    return xp.where(differ[:, None], drawn, xp.ones_like(drawn))


def _chosen(kind: Array, like: Array, values: list[float]) -> Array:
    """The value of each robot's kind, shape (n,)."""
    xp = namespace(like)
    chosen = xp.zeros_like(like)
    for i, value in enumerate(values):
        chosen = xp.where(kind == i, xp.zeros_like(like) + value, chosen)
    return chosen


def _between(bounds: tuple[float, float], draw: Array) -> Array:
    return bounds[0] + (bounds[1] - bounds[0]) * draw
