"""Grounds with goals on them: round a corner, over a drawn course, through an arena."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from saltus.errors import check_known
from saltus.policy.evaluation.walking_grounds import BEFORE_RUBBLE, walking_rubble
from saltus.terrain.course import Course
from saltus.terrain.course_segments import (
    CourseSegment,
    Hurdles,
    Level,
    Ramp,
    RandomSizes,
    Stairs,
    Stones,
    Turn,
)
from saltus.terrain.terrain import Terrain

RoutePoint = tuple[float, float]

_FLOOR_M = 0.005  # two boxes of one height would double every contact
_PART_M = 2.7  # about the length of a part of a drawn course
_PARTS = 8
_SLOPE = _PART_M * math.tan(math.radians(20.0))
_UNEVEN_M, _RUN_M = (0.05, 0.20), (0.25, 0.40)
COURSE_WIDTH_M = 2.0
PARTS: dict[str, tuple[CourseSegment, ...]] = {
    "rubble": (walking_rubble(length=_PART_M, count=round(4.7 * _PART_M * COURSE_WIDTH_M)),),
    "stairs up": (Stairs(steps=9, rise=0.15, run=0.3),),
    "stairs down": (Stairs(steps=9, rise=-0.15, run=0.3),),
    "irregular": tuple(Stairs(steps=1, rise=_UNEVEN_M, run=_RUN_M) for _ in range(8)),
    "stones": (Stones(length=2.5, pitch=0.5, share=0.95, missing=0.0),),
    "ramp up": (Ramp(length=_PART_M, rise=_SLOPE),),
    "ramp down": (Ramp(length=_PART_M, rise=-_SLOPE),),
    "hurdles": (Hurdles(count=2, height=0.15, spacing=1.25),),
}  # fmt: skip
"""Parts of a drawn course by name, with the sizes of the grounds of crossings."""
_LANDING = (Stairs(steps=7, rise=0.15, run=0.28),)
_LANDING_WIDTH_M = 1.5
_FIELD_M, _BLOCKS = 12.0, 400  # 2.8 blocks a square metre, as many as a segment may have
_BESIDE_M = 4.0
_GOALS, _BETWEEN_M, _RIM_M = 5, (7.0, 9.0), 1.0


@dataclass(frozen=True, kw_only=True)
class WalkRoute:
    """A ground and the goals on it, in the order in which they are to be reached."""

    terrain: Terrain
    goals: tuple[RoutePoint, ...]
    """World x and y [m]; the robot starts at x = 0, y = 0."""
    width_m: float
    """A robot further from the straight lines between goals than half of it has left its way."""

    @property
    def length_m(self) -> float:
        """Way from the start over all goals."""
        return float(np.linalg.norm(np.diff([(0.0, 0.0), *self.goals], axis=0), axis=1).sum())


def _landing(rng: np.random.Generator) -> WalkRoute:
    side = float(rng.choice((-1.0, 1.0)))
    return _of_course(
        (Level(length=0.5), *_LANDING, Turn(angle=side * 0.5 * math.pi), *_LANDING, Level()),
        _LANDING_WIDTH_M, rng, "landing",
    )  # fmt: skip


def _course(rng: np.random.Generator) -> WalkRoute:
    """A course whose two corners lead to one side and back; each part and corner ends at a goal."""
    side, ends = float(rng.choice((-1.0, 1.0))), list[int]()
    segments: list[CourseSegment] = [BEFORE_RUBBLE]
    for i, name in enumerate(rng.choice(list(PARTS), _PARTS)):
        if i in (3, 6):
            angle = side * float(rng.uniform(0.5, 0.5 * math.pi))
            segments.append(Turn(angle=angle if i == 3 else -angle))
            ends.append(len(segments) - 1)
        segments.extend(PARTS[name])
        ends.append(len(segments) - 1)
    drawn = _of_course((*segments, Level()), COURSE_WIDTH_M, rng, "course")
    return replace(drawn, goals=tuple(drawn.goals[i] for i in (*ends, len(segments))))


def _of_course(
    segments: tuple[CourseSegment, ...], width: float, rng: np.random.Generator, kind: str
) -> WalkRoute:
    course = Course(kind=kind, segments=segments, width=width, floor_m=_FLOOR_M)
    seed = int(rng.integers(2**32))
    terrain = course.terrain(RandomSizes(np.random.default_rng(seed)))
    goals = tuple(course.ends(RandomSizes(np.random.default_rng(seed))))
    return WalkRoute(terrain=terrain, goals=goals, width_m=width)


def _arena(rng: np.random.Generator) -> WalkRoute:
    """A field of rubble and goals 7 to 9 m from each other, 40 m in all on average."""
    blocks = walking_rubble(length=_FIELD_M, count=_BLOCKS)
    field = Course(
        kind="arena", segments=(BEFORE_RUBBLE, blocks), width=_FIELD_M, floor_m=_FLOOR_M,
        margin_m=_BESIDE_M,
    )  # fmt: skip
    goals, here = list[RoutePoint](), np.zeros(2)
    while len(goals) < _GOALS:
        way, heading = rng.uniform(*_BETWEEN_M), rng.uniform(-math.pi, math.pi)
        there = here + way * np.array([math.cos(heading), math.sin(heading)])
        if _RIM_M < there[0] < _FIELD_M and abs(there[1]) < 0.5 * _FIELD_M - _RIM_M:
            goals.append((float(there[0]), float(there[1])))
            here = there
    return WalkRoute(terrain=field.terrain(RandomSizes(rng)), goals=tuple(goals), width_m=_BESIDE_M)


ROUTES: dict[str, Callable[[np.random.Generator], WalkRoute]] = {
    "landing": _landing, "course": _course, "arena": _arena,
}  # fmt: skip
"""Landing: 7 steps of 0.15 by 0.28 m, a landing of 1.5 m with a turn by 90 degrees to either side,
and 7 steps. Course: eight drawn `PARTS` of 2.5 to 2.7 m and two corners, 25 m. Arena: five goals
in 12 m by 12 m of rubble, 2.8 blocks a square metre up to 0.15 m high.
"""


def make_route(name: str, seed: int) -> WalkRoute:
    """A route by its name, drawn by a seed; `ConfigError` where there is none."""
    check_known("no route", name, ROUTES)
    return ROUTES[name](np.random.default_rng(seed))
