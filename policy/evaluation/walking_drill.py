"""The drill of a walking robot: drawn commands, a stop at full speed, a turn on the spot."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from saltus.arrays import Floats
from saltus.constants import POLICY_DT
from saltus.drive.wish import STAND, Wish
from saltus.policy.evaluation.tracking import tracking_errors
from saltus.policy.evaluation.walking_judge import (
    BEGINS_S,
    WalkEndCause,
    WalkRun,
    base_yaw,
    failure_reason,
    median_or_none,
)
from saltus.policy.evaluation.walks import WalkStep
from saltus.sim.plant_state import PlantState
from saltus.wire.messages import CommandMode, ControllerMode

_STRIDE, _SETTLING = round(0.5 / POLICY_DT), round(1.0 / POLICY_DT)  # those of `walk eval`


@dataclass(frozen=True, kw_only=True)
class DrillResult:
    """One robot that was drilled; lengths and times are NaN where it did not come so far."""

    seed: int
    cause: WalkEndCause
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


# Out into the field, drawn commands, a stop at full speed, a turn on the spot
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


def run_drill(run: WalkRun, seed: int) -> DrillResult:
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
    cause: WalkEndCause = ""
    for step in run(operator):
        steps.append(step)
        cause = failure_reason(step)
        if cause or step.time_s >= _ENDS:
            break
    stop_m, stop_s = _stop(steps)
    turn_s, drift_m = _turn(steps)
    return DrillResult(
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
    cos, sin = math.cos(yaw := base_yaw(truth)), math.sin(yaw)
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
    turned = np.unwrap([base_yaw(step.truth) for step in part])
    done = np.flatnonzero(turned - turned[0] >= math.pi)
    if not done.size:
        return math.nan, math.nan
    there, here = (part[i].truth.position_base_in_world[:2] for i in (0, done[0]))
    return part[done[0]].time_s - _TURN_FROM, float(np.linalg.norm(here - there))


def drill_row(results: Sequence[DrillResult]) -> dict[str, Any]:
    """The figures of one ground."""
    whole = [each for each in results if not each.cause]
    ahead, aside, turn = (
        np.nanmean([each.errors for each in whole], axis=0) if whole else [None] * 3
    )
    return {
        "trials": len(results),
        "failures": dict(Counter(each.cause for each in results if each.cause)),
        "ahead_mps": ahead, "aside_mps": aside, "turn_rps": turn,
        "stop_m": median_or_none([each.stop_m for each in whole]),
        "stop_m_most": max((each.stop_m for each in whole), default=None),
        "stopped_within_1_m": sum(each.stop_m <= 1.0 for each in whole),
        "turn_s": median_or_none([each.turn_s for each in whole if not math.isnan(each.turn_s)]),
        "turned_within_4_s": sum(each.turn_s <= 4.0 for each in whole),
        "outcomes": [vars(each) for each in results],
    }  # fmt: skip
