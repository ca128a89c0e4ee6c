"""Trials of a walking policy as it is deployed: ten metres of each ground, and drills.

Everything but the bus is that of a run: planner, control loop, sensors, drives and body as each
trial draws them, and heights that are true or those of the scan's service. The operator sees where
the robot is, as somebody with a gamepad does.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from saltus.arrays import Floats
from saltus.constants import POLICY_DT
from saltus.controller.tick import CompiledTick
from saltus.drive.wish import STAND, Wish
from saltus.named_setup import named_setups
from saltus.policy.evaluation.evaluate import success_interval
from saltus.policy.evaluation.tracking import tracking_errors
from saltus.policy.evaluation.walking_grounds import FINISH_X, WIDTH_M, drill_ground, ground
from saltus.policy.evaluation.walks import HeightSourceFactory, Operator, WalkStep, walk
from saltus.policy.joints.policy import JointPolicy
from saltus.policy.joints.walker import Walker
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.setup import Setup
from saltus.sim.state import PlantState
from saltus.terrain.terrain import Terrain
from saltus.trial import Trial, is_upright
from saltus.wire.messages import CommandMode, ControllerMode
from saltus.workers import Listener, in_order, tell

SPEEDS_MPS = (0.5, 1.0)
"""Speed ahead that a trial draws."""
BEGINS_S = 1.6
"""When a robot that is told to walk at once follows: it stands for 1 s and gets up for 0.6 s."""
SLACK = 1.5
"""A robot may take so many times the time of its commanded speed, and `BEGINS_S`."""
HEADING_GAIN = MIDDLE_GAIN = 0.5
"""Turning by the error of the heading [1/s], heading by the distance from the middle [rad/m]; the
training's."""
MOST_TURN_RPS = 1.0
SEEDS_AT_A_TIME = 5
_STRIDE, _SETTLING = round(0.5 / POLICY_DT), round(1.0 / POLICY_DT)  # those of `walk eval`

Kind = Literal["cross", "drill"]
Cause = Literal["", "trunk_contact", "not_upright", "stopped", "left", "time_limit"]


@dataclass(frozen=True, kw_only=True)
class WalkTrials:
    """Settings of the trials of one policy."""

    robot: str
    grid: str
    model: Path
    """The policy: an ONNX file, or a TOML file about somebody else's."""
    camera: str = "d435i"
    profile: str = "shipped"

    def setup(self, terrain: Terrain, seed: int) -> Setup:
        """The robot of a trial."""
        trials = [Trial.draw(seed)]
        return named_setups(
            self.robot, self.grid, self.camera, self.profile, [terrain], trials
        )[0]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Crossing:
    """One robot that was to cross a ground."""

    seed: int
    speed_mps: float
    """As commanded."""
    cause: Cause
    """Reason why it did not; empty where it did."""
    distance_m: float
    time_s: float
    """From `BEGINS_S` to the end."""


@dataclass(frozen=True, kw_only=True)
class Drill:
    """One robot that was drilled; lengths and times are NaN where it did not come so far."""

    seed: int
    cause: Cause
    errors: tuple[float, float, float]
    """Mean error of the velocity ahead and aside [m/s] and of the turning [rad/s]."""
    stop_m: float
    """Way from the command to stand, at 1.0 m/s commanded, to the end of the motion."""
    stop_s: float
    """Time to the controller's stand."""
    turn_s: float
    """Time for 180 degrees on the spot, at 1.0 rad/s commanded."""
    turn_drift_m: float
    """Way that the robot went meanwhile."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """Some trials for one process."""

    kind: Kind
    ground: str
    seeds: tuple[int, ...]
    source: HeightSourceFactory

    def run(self, trials: WalkTrials) -> "list[Crossing | Drill]":
        """Runs them one after the other."""
        results: list[Crossing | Drill] = []
        policy, tick = JointPolicy(trials.model), None
        for seed in self.seeds:
            make = ground if self.kind == "cross" else drill_ground
            setup = trials.setup(make(self.ground, seed), seed)
            tick = tick or CompiledTick(setup.robot)
            places = setup.grid.places_of(policy.description.height_grid())
            movers, source = [Walker(setup.robot, policy, places)], self.source(setup)

            def run(operator: Operator, here: Setup = setup) -> Iterator[WalkStep]:
                return walk(here, movers, source, operator, tick)  # noqa: B023 - used at once

            results.append((cross if self.kind == "cross" else drill)(run, seed))
            tell(1.0)
        return results


Run = Callable[[Operator], Iterator[WalkStep]]


def tasks(
    kind: Kind, names: Sequence[str], source: HeightSourceFactory, seeds: Sequence[int]
) -> list[Task]:
    """Trials of some grounds, split up for several processes."""
    parts = [tuple(seeds[i : i + SEEDS_AT_A_TIME]) for i in range(0, len(seeds), SEEDS_AT_A_TIME)]
    return [
        Task(kind=kind, ground=name, seeds=part, source=source) for name in names for part in parts
    ]


def run_tasks(
    trials: WalkTrials,
    todo: Sequence[Task],
    processes: int | None = None,
    listener: Listener | None = None,
) -> "list[list[Crossing | Drill]]":
    """The results of each task; `listener` is told of each trial."""
    return list(in_order(_Runner(trials), todo, processes, listener))


@dataclass(frozen=True)
class _Runner:
    trials: WalkTrials

    def __call__(self, task: Task) -> "list[Crossing | Drill]":
        return task.run(self.trials)


def _failure(step: WalkStep) -> Cause:
    """Why a robot cannot go on after a step; empty where it can."""
    if step.touched:
        return "trunk_contact"
    if not is_upright(step.truth.quaternion_base_in_world):
        return "not_upright"
    return "stopped" if step.mode in (ControllerMode.STOPPED, ControllerMode.DAMP) else ""


def _yaw(truth: PlantState) -> float:
    return float(roll_pitch_yaw(rotation_matrix(truth.quaternion_base_in_world))[2])


def cross(run: Run, seed: int) -> Crossing:
    """Leads a robot over ten metres; the seed draws the speed."""
    speed = float(np.random.default_rng((seed, 1)).uniform(*SPEEDS_MPS))
    limit_s = BEGINS_S + SLACK * FINISH_X / speed

    def operator(time_s: float, truth: PlantState) -> Wish:
        del time_s
        heading = float(np.clip(-MIDDLE_GAIN * truth.position_base_in_world[1], -1.0, 1.0))
        error = math.remainder(heading - _yaw(truth), 2.0 * math.pi)
        turn = float(np.clip(HEADING_GAIN * error, -MOST_TURN_RPS, MOST_TURN_RPS))
        return Wish(mode=CommandMode.WALK, ahead_mps=speed, turn_rps=turn)

    for step in run(operator):
        x, y = step.truth.position_base_in_world[:2]
        cause = _failure(step)
        if not cause and abs(y) > 0.5 * WIDTH_M:
            cause = "left"
        if not cause and step.time_s > limit_s:
            cause = "time_limit"
        if cause or x >= FINISH_X:
            break
    return Crossing(
        seed=seed, speed_mps=speed, cause=cause, distance_m=float(x),
        time_s=step.time_s - BEGINS_S,
    )  # fmt: skip


# The drill: out into the field, drawn commands, a stop at full speed, a turn on the spot
_OUT_S, _DRAWN, _EACH_S = 5.0, 6, 4.0
_FAST_S, _STOP_S, _READY_S, _TURN_S = 3.0, 4.0, 2.0, 6.0
_DRAWN_FROM = BEGINS_S + _OUT_S
_FAST_FROM = _DRAWN_FROM + _DRAWN * _EACH_S
_STOP_FROM = _FAST_FROM + _FAST_S
_READY_FROM = _STOP_FROM + _STOP_S
_TURN_FROM = _READY_FROM + _READY_S
_ENDS = _TURN_FROM + _TURN_S
AHEAD_MPS, ASIDE_MPS, DRAWN_TURN_RPS = (-0.5, 1.0), 0.4, 0.8
"""Ranges of the drill's drawn commands, each within what policies are trained on."""


def drill(run: Run, seed: int) -> Drill:
    """Leads a robot through the drill; the seed draws the commands."""
    rng = np.random.default_rng((seed, 2))
    drawn = [
        Wish(
            mode=CommandMode.WALK,
            ahead_mps=float(rng.uniform(*AHEAD_MPS)),
            left_mps=float(rng.uniform(-ASIDE_MPS, ASIDE_MPS)),
            turn_rps=float(rng.uniform(-DRAWN_TURN_RPS, DRAWN_TURN_RPS)),
        )
        for _ in range(_DRAWN)
    ]

    def operator(time_s: float, truth: PlantState) -> Wish:
        del truth
        if time_s < _DRAWN_FROM:
            return Wish(mode=CommandMode.WALK, ahead_mps=0.7)
        if time_s < _FAST_FROM:
            return drawn[int((time_s - _DRAWN_FROM) / _EACH_S)]
        if time_s < _STOP_FROM:
            return Wish(mode=CommandMode.WALK, ahead_mps=1.0)
        if time_s < _READY_FROM:
            return STAND
        turn = 1.0 if time_s >= _TURN_FROM else 0.0
        return Wish(mode=CommandMode.WALK, turn_rps=turn)

    steps: list[WalkStep] = []
    cause: Cause = ""
    for step in run(operator):
        steps.append(step)
        cause = _failure(step)
        if cause or step.time_s >= _ENDS:
            break
    stop_m, stop_s = _stop(steps)
    turn_s, drift_m = _turn(steps)
    return Drill(
        seed=seed, cause=cause, errors=_errors(steps), stop_m=stop_m, stop_s=stop_s,
        turn_s=turn_s, turn_drift_m=drift_m,
    )  # fmt: skip


def _errors(steps: Sequence[WalkStep]) -> tuple[float, float, float]:
    """Errors of the drawn commands."""
    part = [step for step in steps if _DRAWN_FROM <= step.time_s < _FAST_FROM]
    if not part:
        return math.nan, math.nan, math.nan
    error = np.array([_motion(step.truth) - _asked(step.wish) for step in part])
    fresh = np.array([a.wish != b.wish for a, b in zip(part, [steps[0], *part], strict=False)])
    ahead, aside, turn = tracking_errors(
        error[:, None], fresh[:, None], stride=_STRIDE, settling=_SETTLING
    )
    return ahead, aside, turn


def _asked(wish: Wish) -> Floats:
    return np.array([wish.ahead_mps, wish.left_mps, wish.turn_rps])


def _motion(truth: PlantState) -> Floats:
    """Velocity ahead, to the left, and turning, as commands have them, shape (3,)."""
    cos, sin = math.cos(yaw := _yaw(truth)), math.sin(yaw)
    x, y = truth.velocity_base_in_world[:2]
    return np.array([cos * x + sin * y, cos * y - sin * x, truth.angular_velocity_base[2]])


def _stop(steps: Sequence[WalkStep]) -> tuple[float, float]:
    part = [step for step in steps if _STOP_FROM <= step.time_s < _READY_FROM]
    if len(part) < round(_STOP_S / POLICY_DT) - 1:
        return math.nan, math.nan
    places = np.array([step.truth.position_base_in_world[:2] for step in part])
    stands = next((s.time_s for s in part if s.mode == ControllerMode.STAND), math.nan)
    return float(np.linalg.norm(places - places[0], axis=1).max()), stands - _STOP_FROM


def _turn(steps: Sequence[WalkStep]) -> tuple[float, float]:
    part = [step for step in steps if step.time_s >= _TURN_FROM]
    if not part:
        return math.nan, math.nan
    turned = np.unwrap([_yaw(step.truth) for step in part])
    done = np.flatnonzero(turned - turned[0] >= math.pi)
    if not done.size:
        return math.nan, math.nan
    there, here = (part[i].truth.position_base_in_world[:2] for i in (0, done[0]))
    return part[done[0]].time_s - _TURN_FROM, float(np.linalg.norm(here - there))


def crossing_row(results: Sequence[Crossing]) -> dict[str, Any]:
    """The figures of one ground."""
    crossed = [each for each in results if not each.cause]
    speeds = [FINISH_X / each.time_s / each.speed_mps for each in crossed]
    return {
        "trials": len(results),
        "successes": len(crossed),
        "success_interval95": list(success_interval(len(crossed), len(results))),
        "failures": dict(Counter(each.cause for each in results if each.cause)),
        "speed_by_commanded": _median(speeds),
        "distance_m": _median([each.distance_m for each in results]),
        "outcomes": [vars(each) for each in results],
    }


def drill_row(results: Sequence[Drill]) -> dict[str, Any]:
    """The figures of one ground."""
    whole = [each for each in results if not each.cause]
    ahead, aside, turn = (
        np.nanmean([each.errors for each in whole], axis=0) if whole else [None] * 3
    )
    return {
        "trials": len(results),
        "failures": dict(Counter(each.cause for each in results if each.cause)),
        "ahead_mps": ahead, "aside_mps": aside, "turn_rps": turn,
        "stop_m": _median([each.stop_m for each in whole]),
        "stop_m_most": max((each.stop_m for each in whole), default=None),
        "stopped_within_1_m": sum(each.stop_m <= 1.0 for each in whole),
        "turn_s": _median([each.turn_s for each in whole if not math.isnan(each.turn_s)]),
        "turned_within_4_s": sum(each.turn_s <= 4.0 for each in whole),
        "outcomes": [vars(each) for each in results],
    }  # fmt: skip


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None
