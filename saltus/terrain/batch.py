"""Terrains of training: thousands at once, each drawn from a kind, a difficulty and random numbers, as boxes.

The sizes follow the laws of difficulty of `saltus.terrain.curriculum`; what a course repeats, and where it begins, is
drawn, so that nothing can be learnt by heart. Courses are longer than those of `saltus.terrain`: several trenches
instead of one, several steps up.
"""

from dataclasses import dataclass

from saltus.arrays import Array, namespace
from saltus.terrain.boxes import Boxes
from saltus.terrain.curriculum import FAMILIES
from saltus.terrain.table import OwnCourses
from saltus.terrain.terrain import TRENCH_DEPTH, WIDTH

KINDS = (
    "flat", "stairs", "stepping_stones", "step", "gap",
    "stairs_down", "step_down", "pyramid", "irregular", "hurdles", "ditch",
)  # fmt: skip
"""A kind is its place in this order; those of families of one's own follow. The first five are those of
`saltus.terrain`. The others are trained on only where a curriculum asks for them: ground that leads down, stairs whose
treads and rises differ, thin walls, trenches of any depth.
"""
DESCENDING = ("stairs_down", "step_down", "pyramid", "irregular")
"""Kinds whose ground, without trenches, may lead down."""

COLUMNS = 18
"""Start, up to 16 treads or stones, and ground behind them: what a robot passes in ten jumps."""
BOXES = COLUMNS + 1
"""With the floor of the trenches."""
DRAWS = 8 + COLUMNS
"""Uniform random numbers that one course takes."""

FIRST_EDGE_X = (0.6, 1.6)  # both within reach of the first jump and beyond what the robot sees at the start
STAIR_RUN_M = (0.23, 0.37)  # original
IRREGULAR_RUN_M = (0.22, 0.40)  # of irregular stairs, drawn tread by tread
_LEAST_RISE_SHARE = 0.5  # of irregular stairs: the lowest riser as a share of the highest
HURDLE_M = 0.05  # thickness along x
DITCH_M = (0.05, 1.0)  # depth of a ditch: from a step that is walked through to one that must be jumped
STONE_M = (0.45, 0.60)  # around the 0.5 m of the original
PLATFORM_M = (1.6, 2.6)  # one to three jumps between single obstacles
REPEATS = {
    "flat": 0, "stairs": 16, "stepping_stones": 15, "step": 3, "gap": 4,
    "stairs_down": 16, "step_down": 3, "pyramid": 16, "irregular": 16, "hurdles": 8, "ditch": 4,
}  # fmt: skip
# Rise at difficulty 0 and its growth [m]. As in `FAMILIES`, difficulty 1 is a third or more beyond what a robot should
# take: 0.15 m down or up and down, steps of 0.6 m down, hurdles of 0.2 m.
_RISE_LAWS = {
    "stairs_down": (-0.05, -0.20), "step_down": (0.0, -0.80), "pyramid": (0.05, 0.20),
    "irregular": (0.05, 0.20), "hurdles": (0.0, 0.30),
}  # fmt: skip
_SMALLEST_GAP_SHARE = 0.2  # where gaps differ within a course
_BEHIND_START = 4.0  # ground behind the robot [m]
_RUN_OUT = 6.0  # ground behind the last edge [m]
_THICKNESS = 2.0  # of a box [m]: nothing falls through
_SPARE_TOP = -50.0  # columns that a course does not need lie down there [m]
_FINISH_BEHIND = 1.0  # of the last edge [m]; the trunk is then wholly over it
_FINE = 1024.0
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
    floor: Array
    """Height of the floor under trenches [m], shape (n,)."""
    own: OwnCourses | None = None
    """Courses of families of one's own, where robots are on such."""

    def height_at(self, x: Array, y: Array) -> Array:
        """Ground at world x and y [m], the higher side of an edge; shapes (n, points). Columns reach any y."""
        xp = namespace(x)
        inside = (x[..., None] >= self.low[:, None, :]) & (x[..., None] <= self.high[:, None, :])
        heights = xp.max(xp.where(inside, self.top[:, None, :], self.floor[:, None, None]), axis=-1)
        return heights if self.own is None else self.own.height_at(x, y, heights)

    def boxes(self) -> Boxes:
        """Columns and floor, arrays of shape (n, BOXES, ...); more boxes where courses of one's own have more."""
        xp = namespace(self.low)
        low = xp.concat([self.low, self.low[:, :1]], axis=-1)
        high = xp.concat([self.high, self.high[:, -1:]], axis=-1)
        top = xp.concat([self.top, self.floor[:, None]], axis=-1)
        half = xp.zeros_like(low) + 0.5 * _THICKNESS
        columns = Boxes(
            center=xp.stack([0.5 * (low + high), xp.zeros_like(low), top - half], -1),
            half_size=xp.stack([0.5 * (high - low), xp.zeros_like(low) + 0.5 * WIDTH, half], -1),
        )
        return columns if self.own is None else self.own.boxes(columns)


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
    lengths = _lengths(kind, draws, index)
    count = _chosen(kind, draws[:, 0], [float(REPEATS[name]) for name in KINDS])[:, None]
    gaps = gap[:, None] * _gap_shares(kind, draws)
    used = (index >= 1.0) & (index <= count)
    # Column k > 0 begins behind the gaps and columns before it.
    pitch = xp.where(used, lengths + gaps, xp.zeros_like(gaps))
    ends = start[:, None] + xp.cumulative_sum(pitch, axis=-1)
    low = xp.where(index == 0.0, xp.zeros_like(ends) - _BEHIND_START, ends - lengths)
    last = index >= count
    level_end = xp.where(count > 0.0, xp.zeros_like(ends), xp.zeros_like(ends) + _FLAT_FINISH_X)
    high = xp.where(last, xp.maximum(ends, level_end) + _RUN_OUT, ends)
    heights = _heights(kind, rise, xp.where(used, index, xp.zeros_like(index)), count, draws)
    top = xp.where(index > count, xp.zeros_like(low) + _SPARE_TOP, heights)
    last_edge = ends[:, -1] - xp.sum(xp.where(used & last, lengths, xp.zeros_like(lengths)), axis=-1)
    finish = xp.where(count[:, 0] > 0.0, last_edge + _FINISH_BEHIND, xp.zeros_like(start) + _FLAT_FINISH_X)
    way = xp.clip(last_edge - start, 0.3, None)
    climb = xp.sum(xp.where(used[:, 1:], xp.abs(heights[:, 1:] - heights[:, :-1]), xp.zeros_like(ends[:, 1:])), axis=-1)
    climb = xp.where(_is(kind, *KINDS[5:]), climb, rise * count[:, 0])
    depth = xp.where(_is(kind, "ditch"), _between(DITCH_M, draws[:, 3]), xp.zeros_like(start) + TRENCH_DEPTH)
    floor = xp.min(xp.where(index <= count, heights, xp.zeros_like(heights)), axis=-1) - depth
    return Courses(low=low, high=high, top=top, finish_x=finish, slope=1.0 + climb / way, floor=floor)


def descends(kind: Array) -> Array:
    """Which robots are on a kind of terrain that may lead down, bool, shape (n,)."""
    return _is(kind, *DESCENDING)


def _heights(kind: Array, rise: Array, index: Array, count: Array, draws: Array) -> Array:
    """Height of each column [m], shape (n, COLUMNS); `index` is 0 for columns that a course does not need."""
    xp = namespace(draws)
    half = 0.5 * count
    steps = xp.where(_is(kind, "pyramid")[:, None], half - xp.abs(index - half), index)
    odd = index - 2.0 * xp.floor(0.5 * index)
    steps = xp.where(_is(kind, "hurdles")[:, None], odd, steps)
    shares = _LEAST_RISE_SHARE + (1.0 - _LEAST_RISE_SHARE) * draws[:, 8:]
    drawn = xp.cumulative_sum(xp.where(index > 0.0, shares, xp.zeros_like(shares)), axis=-1)
    side = xp.where(draws[:, 3] < 0.5, -xp.ones_like(rise), xp.ones_like(rise))[:, None]
    return rise[:, None] * xp.where(_is(kind, "irregular")[:, None], side * drawn, steps)


def _sizes(kind: Array, difficulty: Array) -> tuple[Array, Array]:
    """Rise from column to column and width of trenches [m], each of shape (n,)."""
    gap = _law("gap", "gap_m")
    rises = {"stairs": _law("stairs", "rise_m"), "step": _law("step", "height_m"), **_RISE_LAWS}
    gaps = {"stepping_stones": _law("stepping_stones", "gap_m"), "gap": gap, "ditch": gap}
    found = []
    for laws in (rises, gaps):
        base, slope = (_chosen(kind, difficulty, [laws.get(name, (0.0, 0.0))[i] for name in KINDS]) for i in (0, 1))
        found.append(base + slope * difficulty)
    return found[0], found[1]


def _law(kind: str, size: str) -> tuple[float, float]:
    law = FAMILIES[kind].sizes[size]
    return law.base or 0.0, law.slope


_LENGTHS = {
    "flat": PLATFORM_M, "stairs": STAIR_RUN_M, "stepping_stones": STONE_M, "step": PLATFORM_M, "gap": PLATFORM_M,
    "stairs_down": STAIR_RUN_M, "step_down": PLATFORM_M, "pyramid": STAIR_RUN_M, "irregular": STAIR_RUN_M,
    "hurdles": PLATFORM_M, "ditch": PLATFORM_M,
}  # fmt: skip


def _lengths(kind: Array, draws: Array, index: Array) -> Array:
    """Length of each column along x [m], shape (n, COLUMNS)."""
    xp = namespace(draws)
    low, high = (_chosen(kind, draws[:, 1], [_LENGTHS[name][i] for name in KINDS]) for i in (0, 1))
    length = (low + (high - low) * draws[:, 1])[:, None] + xp.zeros_like(index)
    fine = _FINE * draws[:, 8:]  # the lower digits of a uniform number are another one
    drawn = _between(IRREGULAR_RUN_M, fine - xp.floor(fine))
    wall = index - 2.0 * xp.floor(0.5 * index) > 0.0
    length = xp.where(_is(kind, "irregular")[:, None], drawn, length)
    return xp.where(_is(kind, "hurdles")[:, None] & wall, xp.zeros_like(length) + HURDLE_M, length)


def _gap_shares(kind: Array, draws: Array) -> Array:
    """Width of each trench as a share of the widest: half of the courses of stones have equal ones. Shape (n, k)."""
    xp = namespace(draws)
    drawn = _SMALLEST_GAP_SHARE + (1.0 - _SMALLEST_GAP_SHARE) * draws[:, 8:]
    differ = _is(kind, "stepping_stones") & (draws[:, 2] < 0.5)
    return xp.where(differ[:, None], drawn, xp.ones_like(drawn))


def _is(kind: Array, *names: str) -> Array:
    """Which robots are on one of these kinds, bool, shape (n,)."""
    found = kind == KINDS.index(names[0])
    for name in names[1:]:
        found = found | (kind == KINDS.index(name))
    return found


def _chosen(kind: Array, like: Array, values: list[float]) -> Array:
    """The value of each robot's kind, shape (n,)."""
    xp = namespace(like)
    chosen = xp.zeros_like(like)
    for i, value in enumerate(values):
        chosen = xp.where(kind == i, xp.zeros_like(like) + value, chosen)
    return chosen


def _between(bounds: tuple[float, float], draw: Array) -> Array:
    return bounds[0] + (bounds[1] - bounds[0]) * draw
