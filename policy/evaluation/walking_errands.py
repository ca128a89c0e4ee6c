"""Errands of a walking robot: a way over goals, a stop at full speed, a line to start from."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from saltus.arrays import Floats
from saltus.drive.goals import Goals
from saltus.drive.wish import STAND, Wish
from saltus.policy.evaluation.evaluate import success_interval
from saltus.policy.evaluation.walking_grounds import WIDTH_M
from saltus.policy.evaluation.walking_judge import (
    BEGINS_S,
    MOST_TURN_RPS,
    SLACK,
    WalkEndCause,
    WalkRun,
    base_yaw,
    drawn_speed,
    failure_reason,
    walk_along_x,
)
from saltus.policy.evaluation.walking_routes import WalkRoute
from saltus.sim.plant_state import PlantState
from saltus.wire.messages import CommandMode, ControllerMode

STOP_MPS, STOP_AT_M, STOP_WITHIN_M, STOP_S = 1.0, (2.0, 7.0), 1.0, 4.0
"""Speed, where along x the command to stand comes, the way that is allowed, and the time."""
JUMP_STOP_AT_M = (2.0, 5.0)
"""The same place of a robot that jumps: on the stairs and stones of `saltus.policy.evaluation.
walking_jumps`."""
CORNER_S = 3.0
"""Time allowed for the turn at each goal: 180 degrees on the spot take as long."""
LINE_M, LINE_RAD = 0.05, math.radians(3.0)
"""A line is reached within this distance and this error of the heading."""
LINE_S, STAND_S = 30.0, 2.0
"""Time to reach it and to stand; a robot is at rest so long after the command to stand."""
_NEAR_M, _NEAR_RAD = 0.04, math.radians(2.0)  # here the operator lets it stand
_MISSED_M = 0.1  # by which it aims further at most, in each direction
_POSE_GAIN, _POSE_MPS, _POSE_RPS = 1.0, (0.5, 0.3), 0.8
_LEAST_MPS, _LEAST_RPS = 0.25, 0.3  # the shipped policies stand where they are asked for less


@dataclass(frozen=True, kw_only=True)
class ErrandResult:
    """How one robot's errand (a route, a stop, a line or a jump) went."""

    seed: int
    cause: WalkEndCause
    """Reason why it is not done; empty where it is."""
    figures: dict[str, float]
    """Lengths [m], angles [deg] and times [s] of it; NaN where it did not come so far."""


def run_route(run: WalkRun, seed: int, route: WalkRoute) -> ErrandResult:
    """Leads a robot over the goals of a route; the seed draws the speed."""
    speed, places = drawn_speed(seed), np.array([(0.0, 0.0), *route.goals])
    goals = Goals(route.goals, speed, MOST_TURN_RPS)
    limit_s = BEGINS_S + SLACK * route.length_m / speed + CORNER_S * len(route.goals)

    def operator(time_s: float, truth: PlantState) -> Wish:
        del time_s
        return goals.lead(truth.position_base_in_world[:2], base_yaw(truth))

    way_m, last = 0.0, np.zeros(2)
    for step in run(operator):
        here = step.truth.position_base_in_world[:2]
        way_m, last = way_m + float(np.linalg.norm(here - last)), here
        cause = failure_reason(step)
        if not cause and _aside(here, places) > 0.5 * route.width_m:
            cause = "left"
        if not cause and step.time_s > limit_s:
            cause = "time_limit"
        if cause or goals.is_over:
            break
    figures = {
        "goals": float(len(route.goals) - goals.left), "way_m": way_m,
        "time_s": step.time_s - BEGINS_S, "speed_mps": speed,
    }  # fmt: skip
    return ErrandResult(seed=seed, cause=cause, figures=figures)


def _aside(here: Floats, places: Floats) -> float:
    """Distance of a place from the straight lines through others [m]."""
    way = np.diff(places, axis=0)
    share = ((here - places[:-1]) * way).sum(-1) / np.maximum((way * way).sum(-1), 1e-9)
    nearest = places[:-1] + share.clip(0.0, 1.0)[:, None] * way
    return float(np.linalg.norm(here - nearest, axis=1).min())


def run_stop(run: WalkRun, seed: int, *, jumps: bool = False) -> ErrandResult:
    """Leads a robot along x, at 1.0 m/s where it walks, and stops it at a place that is drawn."""
    at_m = JUMP_STOP_AT_M if jumps else STOP_AT_M
    stop_x = float(np.random.default_rng((seed, 3)).uniform(*at_m))
    limit_s = BEGINS_S + SLACK * stop_x / STOP_MPS
    told_s, there, speed_mps = math.nan, np.zeros(2), math.nan

    def operator(time_s: float, truth: PlantState) -> Wish:
        nonlocal told_s, there, speed_mps
        if math.isnan(told_s) and truth.position_base_in_world[0] >= stop_x:
            told_s, there = time_s, truth.position_base_in_world[:2].copy()
            speed_mps = float(np.linalg.norm(truth.velocity_base_in_world[:2]))
        if math.isnan(told_s):
            return Wish(mode=CommandMode.JUMP) if jumps else walk_along_x(truth, STOP_MPS)
        return STAND

    way_m = stood_s = math.nan
    for step in run(operator):
        here, cause = step.truth.position_base_in_world[:2], failure_reason(step)
        if not cause and abs(here[1]) > 0.5 * WIDTH_M:
            cause = "left"
        if math.isnan(told_s):
            if not cause and step.time_s > limit_s:
                cause = "time_limit"
        else:
            way_m = float(np.fmax(way_m, np.linalg.norm(here - there)))
            if math.isnan(stood_s) and step.mode == ControllerMode.STAND:
                stood_s = step.time_s - told_s
        if cause or step.time_s - told_s >= STOP_S:
            break
    if not cause and (way_m > STOP_WITHIN_M or math.isnan(stood_s)):
        cause = "too_far"
    figures = {"way_m": way_m, "time_s": stood_s, "speed_mps": speed_mps}
    return ErrandResult(seed=seed, cause=cause, figures=figures)


def run_line(run: WalkRun, seed: int) -> ErrandResult:
    """Leads a robot to a place and heading that the seed draws, and lets it stand there."""
    rng = np.random.default_rng((seed, 4))
    goal, heading = rng.uniform((0.8, -0.6), (2.5, 0.6)), float(rng.uniform(-0.5, 0.5))
    let_stand_s, aim, aimed_heading = math.inf, goal, heading

    def operator(time_s: float, truth: PlantState) -> Wish:
        nonlocal let_stand_s, aim, aimed_heading
        if time_s - let_stand_s > STAND_S:
            if _within(*_offset(truth, goal, heading), LINE_M, LINE_RAD):
                return STAND
            # Once more, as far beyond as it has come to rest short of the line
            aim = aim + (goal - truth.position_base_in_world[:2]).clip(-_MISSED_M, _MISSED_M)
            aimed_heading += math.remainder(heading - base_yaw(truth), 2.0 * math.pi)
            let_stand_s = math.inf
        offset, error = _offset(truth, aim, aimed_heading)
        if _within(offset, error, _NEAR_M, _NEAR_RAD):
            let_stand_s = min(let_stand_s, time_s)
        return STAND if time_s >= let_stand_s else _to_pose(offset, error)

    for step in run(operator):
        cause: WalkEndCause = failure_reason(step) or ("time_limit" if step.time_s > LINE_S else "")
        offset, error = _offset(step.truth, goal, heading)
        stood = step.time_s - let_stand_s > STAND_S and step.mode == ControllerMode.STAND
        if cause or (stood and _within(offset, error, LINE_M, LINE_RAD)):
            break
    figures = {
        "offset_m": float(np.linalg.norm(offset)), "heading_deg": abs(math.degrees(error)),
        "time_s": step.time_s - BEGINS_S,
    }  # fmt: skip
    return ErrandResult(seed=seed, cause=cause, figures=figures)


def _within(offset: Floats, error: float, most_m: float, most_rad: float) -> bool:
    return bool(np.linalg.norm(offset) < most_m) and abs(error) < most_rad


def _offset(truth: PlantState, goal: Floats, heading: float) -> tuple[Floats, float]:
    """Way to a goal ahead and to the left [m], shape (2,), and turning to its heading [rad]."""
    yaw = base_yaw(truth)
    cos, sin = math.cos(yaw), math.sin(yaw)
    x, y = goal - truth.position_base_in_world[:2]
    error = math.remainder(heading - yaw, 2.0 * math.pi)
    return np.array([cos * x + sin * y, cos * y - sin * x]), error


def _to_pose(offset: Floats, error: float) -> Wish:
    """The command that leads on, no slower than policies follow."""
    limit = np.array(_POSE_MPS)
    velocity = (_POSE_GAIN * offset).clip(-limit, limit)
    speed = float(np.linalg.norm(velocity))
    if float(np.linalg.norm(offset)) < _NEAR_M:
        velocity = np.zeros(2)
    elif speed < _LEAST_MPS:
        velocity = velocity * _LEAST_MPS / max(speed, 1e-6)
    turn = min(max(_POSE_GAIN * error, -_POSE_RPS), _POSE_RPS)
    if abs(error) < _NEAR_RAD:
        turn = 0.0
    elif abs(turn) < _LEAST_RPS:
        turn = math.copysign(_LEAST_RPS, error)
    return Wish(
        mode=CommandMode.WALK, ahead_mps=float(velocity[0]), left_mps=float(velocity[1]),
        turn_rps=turn,
    )  # fmt: skip


def errand_row(results: Sequence[ErrandResult]) -> dict[str, Any]:
    """The figures of one ground: medians over those who did it."""
    done = [each for each in results if not each.cause]
    names = results[0].figures if results else {}
    return {
        "trials": len(results),
        "successes": len(done),
        "success_interval95": list(success_interval(len(done), len(results))),
        "failures": dict(Counter(each.cause for each in results if each.cause)),
        **{
            name: float(np.median([each.figures[name] for each in done])) if done else None
            for name in names
        },
        "outcomes": [{"seed": each.seed, "cause": each.cause, **each.figures} for each in results],
    }
