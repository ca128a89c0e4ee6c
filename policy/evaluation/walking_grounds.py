"""Grounds on which walking is measured: ten metres ahead, and wide ones on which it is drilled."""

import math
from dataclasses import replace
from functools import partial

import numpy as np

from saltus.errors import check_known
from saltus.terrain.course import Course
from saltus.terrain.course_segments import (
    CourseSegment,
    Hurdles,
    Level,
    Ramp,
    RandomSizes,
    Rubble,
    Stairs,
    Stones,
)
from saltus.terrain.terrain import Terrain

FINISH_X = 10.0
"""The robot starts at x = 0 and has crossed a ground here [m]."""
WIDTH_M = 2.5
walking_rubble = partial(Rubble, side=(0.15, 0.6), height=(0.01, 0.15), tilt=0.15)
"""Rubble of trials of walking: `Rubble` with blocks as in the training."""
BEFORE_RUBBLE = Level(length=0.5)
"""Ground before rubble at a start: blocks reach up to 0.42 m beyond their middles. A robot is set
down from above what is highest below its feet. Where that was a block below one of them, two of 100
Go2 fell over before they walked (docs/history.md, "Robots that stop before a step")."""
_UNEVEN = {"rise": (0.05, 0.20), "run": (0.25, 0.40)}  # of irregular stairs, drawn for each tread
_SLOPE = 3.0 * math.tan(math.radians(20.0))


def _irregular(sign: float) -> tuple[CourseSegment, ...]:
    low, high = _UNEVEN["rise"]
    return tuple(
        Stairs(steps=1, rise=(sign * low, sign * high), run=_UNEVEN["run"]) for _ in range(11)
    )


def _stairs(rise: float) -> Stairs:
    return Stairs(steps=14, rise=rise, run=0.28)


GROUNDS: dict[str, tuple[CourseSegment, ...]] = {
    "plain": (Level(length=10.0),),
    "rubble": (BEFORE_RUBBLE, walking_rubble(length=9.0, count=105)),
    "stairs": (Level(length=0.5), _stairs(0.15), Level(length=1.0), _stairs(-0.15), Level()),
    "irregular": (
        Level(length=0.5), *_irregular(1.0), Level(length=1.0), *_irregular(-1.0), Level(length=2.0)
    ),
    "stones": (Level(length=0.7), Stones(length=8.0, pitch=0.5, share=0.95, missing=0.0)),
    "ramps": (
        Level(length=1.0), Ramp(length=3.0, rise=_SLOPE), Level(length=1.0),
        Ramp(length=3.0, rise=-_SLOPE), Level(),
    ),
    "hurdles": (Level(length=0.5), Hurdles(count=7, height=0.15, spacing=1.1)),
}  # fmt: skip
"""Grounds by name.

Rubble: 4.7 blocks a square metre, as in the training, up to 0.15 m high. Stairs: 14 of 0.15 by
0.28 m up, and down again. Irregular: 11 up and 11 down, each 0.05 to 0.20 m high and 0.25 to 0.40 m
long. Stones: of 0.33 to 0.48 m in cells of 0.5 m over a trench of 0.4 m, up to 3 cm higher or lower;
gaps are 0.10 m on average. Ramps: 20 degrees up and down. Hurdles: seven of 0.15 m.
"""
DRILL_GROUNDS = ("plain", "rubble")
_DRILL_M = 9.0  # length and width of the field on which robots are drilled
_BESIDE_M = 12.0  # level ground around it: robots may leave the field


def make_walk_ground(name: str, seed: int) -> Terrain:
    """Ten metres of a ground by its name, drawn by a seed; `ConfigError` where there is none."""
    check_known("no ground", name, GROUNDS)
    floor = 0.005 if name in DRILL_GROUNDS else 0.0
    course = Course(kind=name, segments=GROUNDS[name], width=WIDTH_M, floor_m=floor)
    return replace(course.terrain(RandomSizes(np.random.default_rng(seed))), finish_x=FINISH_X)


def drill_ground(name: str, seed: int) -> Terrain:
    """A field of one of `DRILL_GROUNDS`, with level ground around it."""
    check_known("no ground for drills", name, DRILL_GROUNDS)
    blocks = walking_rubble(length=_DRILL_M, count=round(4.7 * _DRILL_M**2))
    segments = (Level(length=_DRILL_M),) if name == "plain" else (BEFORE_RUBBLE, blocks)
    course = Course(kind=name, segments=segments, width=_DRILL_M, floor_m=0.005, margin_m=_BESIDE_M)
    return course.terrain(RandomSizes(np.random.default_rng(seed)))
