"""Difficulty of a robot's next course: a level that rises with the way it came,
and falls again.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from saltus.arrays import Array, namespace
from saltus.config import check_between
from saltus.errors import ConfigError
from saltus.flags import flag_help
from saltus.terrain.course_batch import BOXES
from saltus.terrain.course_law import KINDS
from saltus.terrain.course_table import CourseTable


@dataclass(frozen=True, kw_only=True)
class CurriculumSettings:
    """Settings of the curriculum of terrains: kinds, levels, and what is asked for a promotion."""

    flat: float = 0.05
    stairs: float = 0.40
    stepping_stones: float = 0.15
    step: float = 0.25
    gap: float = 0.15
    """Share of the robots on each kind of terrain, relative to the others.

    A robot stays on its kind.
    """
    stairs_down: float = 0.0
    step_down: float = 0.0
    pyramid: float = 0.0
    irregular: float = 0.0
    hurdles: float = 0.0
    ditch: float = 0.0
    """Share of this kind and of the five above, which are left out unless they are asked for, see
    `saltus.terrain.course_law.KINDS`."""
    own: Annotated[dict[str, float], flag_help("NAME SHARE ...", "none")] = field(
        default_factory=dict
    )
    """Share of ramp_up, ramp_down, and of families of your own, by name.

    See `saltus.terrain.own_families`.
    """
    levels: int = 10
    """Level k has difficulties from k / levels to (k + 1) / levels of the hardest."""
    hardest: float = 1.0
    """Difficulty at the end of the last level."""
    promotion_m: float = 4.5
    """Way along the terrain's profile, up and along, that earns a harder course; original, but
    horizontal there: 10 jumps of 0.4 m up steep stairs never sufficed."""
    demotion_m: float = 2.5
    """Less than this leads to an easier course; original."""
    any_level: float = 0.0
    """Share of the courses that are of any level, however far the robot came before: for a policy
    that is trained further, which may fail at one level and manage a harder one."""

    def __post_init__(self) -> None:
        check_between(self, **dict.fromkeys(KINDS, (0.0, 1e6)))
        check_between(
            self,
            levels=(1, 255),
            hardest=(0.0, 2.0),
            promotion_m=(0.0, 100.0),
            demotion_m=(0.0, 100.0),
        )
        check_between(self, any_level=(0.0, 1.0))
        for kind, share in self.own.items():
            if kind in KINDS or not 0.0 <= share <= 1e6:
                raise ConfigError(
                    f"own.{kind} = {share:g}: a family of your own, and a share from 0 to 1e+06"
                )
        if not any(self.shares.values()):
            raise ConfigError("the shares of all kinds of terrain are 0: one must be more")

    @property
    def shares(self) -> dict[str, float]:
        """Shares of the kinds of terrain, `KINDS` and then those of one's own.

        A kind is its place in it.
        """
        return {kind: getattr(self, kind) for kind in KINDS} | self.own

    @property
    def table(self) -> CourseTable | None:
        """Courses of the families of one's own; None where there are none.

        Raises:
            ConfigError: a family is not installed here, or makes no course.
        """
        return (
            CourseTable.of(tuple(self.own), self.levels, self.hardest, BOXES) if self.own else None
        )

    @property
    def boxes(self) -> int:
        """How many a course may have."""
        return BOXES if self.table is None else self.table.boxes


def kinds_of_robots(shares: Mapping[str, float], count: int) -> list[int]:
    """The kind of each robot as its place in `shares`, which are relative to each other.

    Kinds lie side by side.
    """
    ends, total = [], 0.0
    for share in shares.values():
        total += share / sum(shares.values())
        ends.append(round(total * count))
    return [next(k for k, end in enumerate(ends) if robot < end) for robot in range(count)]


def next_level(
    config: CurriculumSettings,
    level: Array,
    way: Array,
    failed: Array,
    finished: Array,
    draw: Array,
) -> Array:
    """Level of the next course, whole numbers as floats.

    Beyond the last, and in a share of cases, any level.

    Args:
        config: What is asked for.
        level: of the course that is over, shape (n,).
        way: Way along the profile [m], shape (n,).
        failed: The robot fell, bool, shape (n,).
        finished: It came to the end of the course, bool, shape (n,).
        draw: Uniform in [0, 1), shape (n,).
    """
    up = ~failed & (finished | (way > config.promotion_m))
    down = ~up & (way < config.demotion_m)
    return moved_level(config.levels, level, up, down, draw, any_level=config.any_level)


def moved_level(
    levels: int, level: Array, up: Array, down: Array, draw: Array, *, any_level: float = 0.0
) -> Array:
    """The level above or below, whole numbers as floats;
    beyond the last, and in a share `any_level`, any level.

    Args:
        levels: How many there are.
        level: The present one, shape (n,).
        up: Who goes up, bool, shape (n,).
        down: Who goes down, bool, shape (n,).
        draw: Uniform in [0, 1), shape (n,).
        any_level: Share of those who get any level.
    """
    xp = namespace(level)
    one = xp.ones_like(level)
    moved = xp.clip(
        level + xp.where(up, one, 0.0 * one) - xp.where(down, one, 0.0 * one), 0.0, None
    )
    place = draw * levels
    drawn = xp.floor(place)
    is_drawn = place - drawn < any_level  # the fraction of a uniform number is uniform, too
    return xp.where(is_drawn | (moved >= levels), drawn, moved)


def level_difficulty(config: CurriculumSettings, level: Array, draw: Array) -> Array:
    """Difficulty of a course of `level`, shape (n,)."""
    return config.hardest * (level + draw) / config.levels
