"""Jumps of a robot that is led: over ground that may lie askew, in a heading that is commanded."""

import math
from dataclasses import dataclass

import numpy as np

from saltus.drive.wish import Wish
from saltus.errors import check_known
from saltus.policy.evaluation.walking_errands import ErrandResult
from saltus.policy.evaluation.walking_judge import WalkEndCause, WalkRun, base_yaw, failure_reason
from saltus.policy.mover import MOST_TURN_RPS
from saltus.sim.plant_state import PlantState
from saltus.terrain.course_segments import CourseSegment, Ditch, Level, RandomSizes, Stairs
from saltus.terrain.course_way import CourseWay
from saltus.terrain.terrain import (
    FINISH_AFTER_COURSE,
    FIRST_EDGE_X,
    GROUND_START_X,
    RUN_OUT,
    TRENCH_DEPTH,
    Terrain,
)
from saltus.trial import TIME_LIMIT_S
from saltus.wire.messages import CommandMode, ControllerMode

_STONES = (Ditch(length=(0.1, 0.5), depth=TRENCH_DEPTH), Level(length=0.5))
JUMPED: dict[str, tuple[CourseSegment, ...]] = {
    "plain": (Level(length=4.0),),
    "stairs": (Stairs(steps=14, rise=0.20, run=0.25),),
    "stones": _STONES * 8,
    "trench": (Ditch(length=0.5, depth=TRENCH_DEPTH),),
}
"""Grounds to jump over by name, behind 1.5 m of level ground.

Stairs: 14 of 0.20 by 0.25 m. Stones: eight of 0.5 m, behind gaps of 0.1 to 0.5 m. Trench: one of
0.5 m. All gaps are 0.4 m deep.
"""
WIDTH_M, _FLOOR_M = 12.0, 0.005
HELD_S = 3.0
"""The heading is judged so long after the robot was first told to turn, or at the end of the run
[s]."""


@dataclass(frozen=True, kw_only=True)
class JumpAngles:
    """How far the ground of a led jump lies askew and the robot is told to turn, to the left
    positive [deg].
    """

    askew_deg: float = 0.0
    """The ground lies so much askew: it is turned about the start."""
    heading_deg: float = 0.0
    """The robot is told to turn so much as soon as it jumps."""


def jumped_ground(name: str, seed: int, askew_deg: float = 0.0) -> Terrain:
    """A ground by its name, drawn by a seed; `finish_x` lies in the direction in which it leads.

    `ConfigError` where there is none.
    """
    check_known("no ground to jump over", name, JUMPED)
    way, draws = (
        CourseWay(width=WIDTH_M, yaw=math.radians(askew_deg)),
        RandomSizes(np.random.default_rng(seed)),
    )
    way.go(GROUND_START_X)
    for segment in (Level(length=FIRST_EDGE_X - GROUND_START_X), *JUMPED[name]):
        segment.lay(way, draws)
    finish = math.hypot(way.x, way.y) + FINISH_AFTER_COURSE
    Level(length=RUN_OUT).lay(way, draws)
    return Terrain(kind=name, boxes=way.boxes(_FLOOR_M, 0.0), finish_x=finish)


def run_jump(run: WalkRun, seed: int, angles: JumpAngles, finish_m: float) -> ErrandResult:
    """Lets a robot jump as far in the direction of the ground, in a heading that it is told."""
    askew, told = math.radians(angles.askew_deg), math.radians(angles.heading_deg)
    direction, goes_s = np.array([math.cos(askew), math.sin(askew)]), math.nan

    def operator(time_s: float, truth: PlantState) -> Wish:
        del truth
        turns = time_s - goes_s < abs(told) / MOST_TURN_RPS
        turn_rps = math.copysign(MOST_TURN_RPS, told) if turns else 0.0
        return Wish(mode=CommandMode.JUMP, turn_rps=turn_rps)

    first = error = math.nan
    for step in run(operator):
        yaw, ahead = base_yaw(step.truth), float(step.truth.position_base_in_world[:2] @ direction)
        if math.isnan(goes_s):
            first = yaw
            goes_s = step.time_s if step.mode == ControllerMode.RUN else math.nan
        if step.time_s - goes_s <= HELD_S:
            error = abs(math.degrees(math.remainder(yaw - first - told, 2.0 * math.pi)))
        cause: WalkEndCause = failure_reason(step) or (
            "time_limit" if step.time_s > TIME_LIMIT_S else ""
        )
        if cause or ahead >= finish_m:
            break
    figures = {"heading_deg": error, "time_s": step.time_s - goes_s}
    return ErrandResult(seed=seed, cause=cause, figures=figures)
