"""Courses of training: thousands at once, their sizes drawn by kind and difficulty, as boxes.

Sizes follow the laws of difficulty of `saltus.terrain.curriculum`, columns those of
`saltus.terrain.course_law`; what a course repeats, and where it begins, is drawn, so that nothing
can be learnt by heart. Courses are longer than single ones: several trenches instead of one,
several steps up.
"""

from dataclasses import dataclass

from saltus.arrays import Array, ColumnNames, Points, Scalars, Steps, namespace
from saltus.terrain.boxes import Boxes
from saltus.terrain.course_law import DESCENDING, KINDS, course_shape, is_kind, scale_draw
from saltus.terrain.course_table import OwnCourses
from saltus.terrain.curriculum import FAMILIES, FamilySize
from saltus.terrain.terrain import TRENCH_DEPTH, WIDTH

COLUMNS = 18
"""Start, up to 16 treads or stones, and ground behind them: what a robot passes in ten jumps."""
BOXES = COLUMNS + 1
"""With the floor of the trenches."""
DRAWS = ColumnNames(start=(), length=(), differ=(), depth=(), unused=(4,), columns=(COLUMNS,))
"""Uniform random numbers that one course takes.

The depth of a ditch tells irregular stairs if they lead down.
"""

# Both within reach of the first jump and beyond what the robot sees at the start
FIRST_EDGE_X = (
    0.6,
    1.6,
)
STAIR_RUN_M = (0.23, 0.37)  # original
DITCH_M = (0.05, 1.0)
"""Depth of a ditch: from a step that is walked through to one that must be jumped."""
STONE_M = (0.45, 0.60)  # around the 0.5 m of the original
PLATFORM_M = (1.6, 2.6)  # one to three jumps between single obstacles
REPEATS = {
    "flat": 0, "stairs": 16, "stepping_stones": 15, "step": 3, "gap": 4,
    "stairs_down": 16, "step_down": 3, "pyramid": 16, "irregular": 16, "hurdles": 8, "ditch": 4,
}  # fmt: skip
_LENGTHS = {
    "stairs": STAIR_RUN_M,
    "stairs_down": STAIR_RUN_M,
    "pyramid": STAIR_RUN_M,
    "stepping_stones": STONE_M,
}
_SMALLEST_GAP_SHARE = 0.2  # where gaps differ within a course
_BEHIND_START = 4.0  # ground behind the robot [m]
_RUN_OUT = 6.0  # ground behind the last edge [m]
_THICKNESS = 2.0  # of a box [m]: nothing falls through
_SPARE_TOP = -50.0  # columns that a course does not need lie down there [m]
_FINISH_BEHIND = 1.0  # of the last edge [m]; the trunk is then wholly over it
_FLAT_FINISH_X = 8.0  # ten jumps of 0.8 m


@dataclass(frozen=True, kw_only=True, eq=False)
class CourseBatch:
    """Columns that may overlap; the highest at a place is the ground.

    Arrays with a leading dimension of robots.
    """

    low: Steps
    """Where each column begins [m], world x, shape (n, COLUMNS)."""
    high: Steps
    """Where it ends [m]."""
    top: Steps
    """Its height [m]; columns that a course does not need lie far below."""
    finish_x: Scalars
    """End of the course [m], shape (n,)."""
    slope: Scalars
    """Length of way, up and along, for each metre ahead, on average over the course; shape (n,)."""
    floor: Scalars
    """Height of the floor under trenches [m], shape (n,)."""
    own: OwnCourses | None = None
    """Courses of families of one's own, where robots are on such."""

    def height_at(self, x: Points, y: Array) -> Points:
        """Ground at world x and y [m], the higher side of an edge; shapes (n, points).

        Columns reach any y.
        """
        xp = namespace(x)
        inside = (x[..., None] >= self.low[:, None, :]) & (x[..., None] <= self.high[:, None, :])
        heights = xp.max(xp.where(inside, self.top[:, None, :], self.floor[:, None, None]), axis=-1)
        return heights if self.own is None else self.own.height_at(x, y, heights)

    def boxes(self) -> Boxes:
        """Columns and floor, arrays of shape (n, BOXES, ...);
        more boxes where courses of one's own have more.
        """
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


def draw_courses(kind: Array, difficulty: Array, draws: Array) -> CourseBatch:
    """Draws one course for each robot: sizes by the difficulty, columns by `terrain.law`.

    Args:
        kind: Place in `KINDS`, integers, shape (n,).
        difficulty: 0 to 1, shape (n,).
        draws: Uniform in [0, 1), shape (n, DRAWS.count).
    """
    xp, drawn = namespace(draws), DRAWS.of(draws)
    start = scale_draw(FIRST_EDGE_X, drawn.start)
    one, zero = xp.ones_like(start), xp.zeros_like(start)
    count = _chosen(kind, start, [float(REPEATS[name]) for name in KINDS])
    low, high = (
        _chosen(kind, start, [_LENGTHS.get(name, PLATFORM_M)[i] for name in KINDS]) for i in (0, 1)
    )
    rise, gap = (_size(kind, difficulty, *names) for names in (("rise_m", "height_m"), ("gap_m",)))
    leads_down = is_kind(kind, "stairs_down", "step_down") | (
        is_kind(kind, "irregular") & (drawn.depth < 0.5)
    )
    # Half of the courses of stones have trenches of one width.
    differ = is_kind(kind, "stepping_stones") & (drawn.differ < 0.5)
    made = course_shape(
        kind,
        count=count,
        rise=xp.where(leads_down, -rise, rise),
        length=low + (high - low) * drawn.length,
        gap=(xp.where(differ, _SMALLEST_GAP_SHARE * one, one) * gap, gap),
        depth=xp.where(
            is_kind(kind, "ditch"), scale_draw(DITCH_M, drawn.depth), zero + TRENCH_DEPTH
        ),
        draws=drawn.columns,
    )
    index = xp.cumulative_sum(xp.ones_like(made.top), axis=-1) - 1.0  # (n, COLUMNS): 0, 1, 2, ...
    used = (index >= 1.0) & (index <= count[:, None])
    # Column k > 0 begins behind the gaps and columns before it.
    ends = start[:, None] + xp.cumulative_sum(
        xp.where(used, made.length + made.gap, 0.0 * index), axis=-1
    )
    low_x = xp.where(index == 0.0, 0.0 * index - _BEHIND_START, ends - made.length)
    level_end = xp.where(count > 0.0, zero, zero + _FLAT_FINISH_X)[:, None]
    high_x = xp.where(index >= count[:, None], xp.maximum(ends, level_end) + _RUN_OUT, ends)
    last_length = xp.sum(
        xp.where(used & (index == count[:, None]), made.length, 0.0 * index), axis=-1
    )
    last_edge = ends[:, -1] - last_length
    climb = xp.sum(
        xp.where(used[:, 1:], xp.abs(made.top[:, 1:] - made.top[:, :-1]), 0.0 * index[:, 1:]),
        axis=-1,
    )
    return CourseBatch(
        low=low_x,
        high=high_x,
        top=xp.where(index > count[:, None], 0.0 * index + _SPARE_TOP, made.top),
        finish_x=xp.where(count > 0.0, last_edge + _FINISH_BEHIND, zero + _FLAT_FINISH_X),
        slope=1.0 + climb / xp.clip(last_edge - start, 0.3, None),
        floor=made.floor,
    )


def may_lead_down(kind: Array) -> Array:
    """Which robots are on a kind of terrain that may lead down, bool, shape (n,)."""
    return is_kind(kind, *DESCENDING)


def _size(kind: Array, difficulty: Array, *names: str) -> Array:
    """Size of one of these names of each robot's kind at its difficulty [m], 0 without.

    Shape (n,).
    """
    none = FamilySize(default=0.0, low=0.0, high=0.0, base=0.0)
    sizes = [
        next((FAMILIES[kind].sizes[n] for n in names if n in FAMILIES[kind].sizes), none)
        for kind in KINDS
    ]
    base = _chosen(kind, difficulty, [size.base or 0.0 for size in sizes])
    return base + _chosen(kind, difficulty, [size.slope for size in sizes]) * difficulty


def _chosen(kind: Array, like: Array, values: list[float]) -> Array:
    """The value of each robot's kind, shape (n,)."""
    xp = namespace(like)
    chosen = xp.zeros_like(like)
    for i, value in enumerate(values):
        chosen = xp.where(kind == i, xp.zeros_like(like) + value, chosen)
    return chosen
