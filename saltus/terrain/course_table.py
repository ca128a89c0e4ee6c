"""Courses of families of one's own for a training:
made before it begins, for robots to draw from at every start.

A function of one's own makes one terrain at a time, on a processor; a training starts thousands of
courses a second.
"""

from dataclasses import dataclass, fields
from functools import cache

import numpy as np

from saltus.arrays import Array, namespace
from saltus.terrain.boxes import Boxes
from saltus.terrain.curriculum import find_family
from saltus.terrain.terrain import LEVEL_M, TRENCH_DEPTH
from saltus.terrain.terrain_stack import SPARE_DEPTH, SPARE_SIZE, TerrainStack

VARIANTS = 32
"""Courses of each family and level.

With ten levels 320, of which a robot meets some ten on its way up.
"""
MANY_VARIANTS = 1024
"""Courses of each family where there is one level, as in data for predictors: thousands of robots
would learn 32 scenes by heart."""
_LOOK_M = 0.01  # between the places at which the lowest ground of a course is looked for


@dataclass(frozen=True, kw_only=True, eq=False)
class CourseTable:
    """Courses of some families, level by level, `variants` each.

    Those of a family follow one another.
    """

    levels: int
    variants: int
    ground: Boxes
    """As high as the courses, arrays of shape (courses, some, ...)."""
    solid: Boxes
    """Ground that robots step on: each box once, spare ones far below; arrays of shape (courses,
    boxes, ...)."""
    finish_x: Array
    """From the start [m], shape (courses,)."""
    slope: Array
    """Length of way, up or down and along, for each metre ahead; shape (courses,)."""
    floor: Array
    """Where a trench in the lowest ground would end [m], shape (courses,)."""
    leads_down: Array
    """True where the finish is lower than the start, bool, shape (courses,)."""

    @staticmethod
    @cache
    def of(names: tuple[str, ...], levels: int, hardest: float, boxes: int) -> "CourseTable":
        """The courses of families, the same ones whenever they are asked for, in numpy.

        Args:
            names: Of the families.
            levels: Level k has difficulties from k / levels to (k + 1) / levels of `hardest`, at
                most 1.
            hardest: Difficulty at the end of the last level.
            boxes: How many a course has in `solid`, at least.

        Raises:
            ConfigError: there is no such family, or it makes no course.
        """
        terrains, variants = [], VARIANTS if levels > 1 else MANY_VARIANTS
        for family in map(find_family, names):
            for level, variant in np.ndindex(levels, variants):
                rng = np.random.default_rng([level, variant])
                terrains.append(family(min(hardest * (level + rng.uniform()) / levels, 1.0), rng))
        stack = TerrainStack(terrains)
        ground, solid = stack.ground, stack.boxes(max(stack.widest, boxes))
        start_x = np.array([terrain.start_x for terrain in terrains])
        for array in (ground.center, solid.center):
            array[..., 0] -= start_x[:, None]
        along = [
            t.height_at(np.append(np.arange(t.start_x, t.finish_x, _LOOK_M), t.finish_x), 0.0)
            for t in terrains
        ]
        lowest, last = (
            np.array([heights.min() for heights in along]),
            np.array([heights[-1] for heights in along]),
        )
        finish_x = stack.finish_x - start_x
        return CourseTable(
            levels=levels, variants=variants, ground=ground, solid=solid, finish_x=finish_x,
            slope=1.0 + np.abs(last) / finish_x, floor=lowest - TRENCH_DEPTH,
            leads_down=last < -LEVEL_M,
        )  # fmt: skip

    @property
    def boxes(self) -> int:
        """How many a course has in `solid`."""
        return int(self.solid.center.shape[1])

    def like(self, array: Array) -> "CourseTable":
        """A copy of the table in the library, dtype and device of `array`."""
        xp = namespace(array)
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        for name in ("finish_x", "slope", "floor"):
            values[name] = xp.asarray(values[name], dtype=array.dtype, device=array.device)
        values["leads_down"] = xp.asarray(self.leads_down, device=array.device)
        return CourseTable(
            **values | {name: values[name].like(array) for name in ("ground", "solid")}
        )

    def draw(self, family: Array, level: Array, draw: Array) -> Array:
        """Places of courses in the table.

        Args:
            family: Place in the names of `of`, whole numbers; any for who needs none. Shape (n,).
            level: Whole numbers, as floats; shape (n,).
            draw: Uniform in [0, 1), shape (n,).
        """
        xp = namespace(draw)
        variant = xp.clip(xp.floor(draw * self.variants), 0.0, self.variants - 1.0)
        row = xp.clip(family, 0, None) * self.levels + xp.clip(level, 0.0, self.levels - 1.0)
        return xp.astype(row * self.variants + variant, xp.int64)


@dataclass(frozen=True, kw_only=True, eq=False)
class OwnCourses:
    """Which robots are on courses of a table, and on which."""

    table: CourseTable
    course: Array
    """Place of each robot's course in the table, whole numbers, shape (n,)."""
    used: Array
    """True where the robot is on it, bool, shape (n,)."""

    def height_at(self, x: Array, y: Array, otherwise: Array) -> Array:
        """Ground at world x and y [m], `otherwise` of the other robots.

        All of shape (n, points).
        """
        heights = self.table.ground.of_robot(self.course).height_at(x, y)
        return namespace(x).where(self.used[:, None], heights, otherwise)

    def boxes(self, otherwise: Boxes) -> Boxes:
        """Boxes that robots step on, `otherwise` for others.

        Arrays of shape (n, `CourseTable.boxes`, ...).
        """
        xp, own = namespace(otherwise.center), self.table.solid.of_robot(self.course)
        spare = xp.zeros_like(own.center[:, otherwise.center.shape[1] :])
        center = xp.concat([otherwise.center, spare + SPARE_DEPTH], axis=1)
        half_size = xp.concat([otherwise.half_size, spare + 0.5 * SPARE_SIZE], axis=1)
        used = self.used[:, None, None]
        return Boxes(
            center=xp.where(used, own.center, center),
            half_size=xp.where(used, own.half_size, half_size),
            turn=None if own.turn is None else xp.where(used, own.turn, xp.zeros_like(own.turn)),
        )
