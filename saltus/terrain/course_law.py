"""The one law of each kind of terrain that is made of level columns,
for one course (`level`) and thousands (`course_batch`).

A course is columns behind the ground at the start, each with a trench before it that may have no
width.
"""

from dataclasses import dataclass

from saltus.arrays import Array, namespace

KINDS = (
    "flat", "stairs", "stepping_stones", "step", "gap",
    "stairs_down", "step_down", "pyramid", "irregular", "hurdles", "ditch",
)  # fmt: skip
"""A kind is its place in this order; those of families of one's own follow."""
PAPER = KINDS[:5]
"""Kinds of the paper.

In the others ground leads down, treads and rises differ, walls are thin, trenches of any depth.
"""
DESCENDING = ("stairs_down", "step_down", "pyramid", "irregular")
"""Kinds whose ground, without trenches, may lead down."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CourseShape:
    """Columns of courses; column 0 is the ground at the start.

    Arrays with a leading dimension of courses.
    """

    length: Array
    """Length of each column along x [m], shape (n, columns)."""
    gap: Array
    """Width of the trench before it [m], shape (n, columns)."""
    top: Array
    """Its height [m], shape (n, columns); columns that a course does not need have one, too."""
    floor: Array
    """Height of the floor of trenches [m], shape (n,)."""


IRREGULAR_RUN_M = (0.22, 0.40)  # treads of irregular stairs are drawn from this
LEAST_RISE_SHARE = 0.12 / 0.22  # of irregular stairs: the lowest riser as a share of the highest
HURDLE_M = 0.05  # thickness of a hurdle along x
_FINE = 1024.0


def course_shape(
    kind: Array,
    *,
    count: Array,
    rise: Array,
    length: Array,
    gap: tuple[Array, Array],
    depth: Array,
    draws: Array,
) -> CourseShape:
    """The columns of each course.

    Args:
        kind: Place in `KINDS`, integers, shape (n,).
        count: How many columns a course needs behind the start, whole numbers as floats, shape
            (n,).
        rise: From each column to the next, of a hurdle its height, of irregular stairs the highest
            riser [m]; negative leads down. Shape (n,).
        length: Of the columns along x [m], shape (n,); of hurdles from one to the next, not of
            irregular stairs.
        gap: Least and greatest width of trenches [m], each of shape (n,).
        depth: Of trenches below the lowest column [m], shape (n,).
        draws: Uniform in [0, 1), shape (n, columns).
    """
    xp = namespace(draws)
    zero = xp.zeros_like(draws)
    index = xp.cumulative_sum(zero + 1.0, axis=-1) - 1.0  # 0, 1, 2, ...
    index = xp.where(index <= count[:, None], index, zero)
    is_irregular, is_hurdles = (is_kind(kind, name)[:, None] for name in ("irregular", "hurdles"))
    of_rises, of_gaps = draws, draws  # irregular stairs have no trenches
    # The lower digits of a uniform number are another one
    of_treads = _FINE * draws - xp.floor(_FINE * draws)
    along = xp.where(is_irregular, scale_draw(IRREGULAR_RUN_M, of_treads), length[:, None] + zero)
    wall = index - 2.0 * xp.floor(0.5 * index)
    half = 0.5 * count[:, None]
    steps = xp.where(is_kind(kind, "pyramid")[:, None], half - xp.abs(index - half), index)
    steps = xp.where(is_hurdles, wall, steps)
    shares = xp.where(index > 0.0, scale_draw((LEAST_RISE_SHARE, 1.0), of_rises), zero)
    top = rise[:, None] * xp.where(is_irregular, xp.cumulative_sum(shares, axis=-1), steps)
    return CourseShape(
        length=xp.where(is_hurdles & (wall > 0.0), zero + HURDLE_M, along),
        gap=gap[0][:, None] + (gap[1] - gap[0])[:, None] * of_gaps,
        top=top,
        floor=xp.min(top, axis=-1) - depth,
    )


def is_kind(kind: Array, *names: str) -> Array:
    """Which courses are of one of these kinds, bool, shape (n,)."""
    found = kind == KINDS.index(names[0])
    for name in names[1:]:
        found = found | (kind == KINDS.index(name))
    return found


def scale_draw(bounds: tuple[float, float], draw: Array) -> Array:
    """Returns what a uniform draw from [0, 1) makes of these bounds, of its shape."""
    return bounds[0] + (bounds[1] - bounds[0]) * draw
