"""Parts that all trials of walking share: how a robot is led, and when it cannot go on."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Literal

import numpy as np

from saltus.drive.wish import Wish
from saltus.policy.evaluation.walks import WalkOperator, WalkStep
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.sim.plant_state import PlantState
from saltus.trial import is_upright
from saltus.wire.messages import CommandMode, ControllerMode

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

WalkEndCause = Literal[
    "", "trunk_contact", "not_upright", "stopped", "left", "time_limit", "too_far"
]
WalkRun = Callable[[WalkOperator], Iterator[WalkStep]]
"""A robot, told by an operator, step by step."""


def failure_reason(step: WalkStep) -> WalkEndCause:
    """Reason for which a robot cannot go on after a step; empty where it can."""
    if step.touched:
        return "trunk_contact"
    if not is_upright(step.truth.quaternion_base_in_world):
        return "not_upright"
    return "stopped" if step.mode in (ControllerMode.STOPPED, ControllerMode.DAMP) else ""


def base_yaw(truth: PlantState) -> float:
    """Yaw of the base [rad]."""
    return float(roll_pitch_yaw(rotation_matrix(truth.quaternion_base_in_world))[2])


def drawn_speed(seed: int) -> float:
    """Speed at which a trial's robot is led [m/s]."""
    return float(np.random.default_rng((seed, 1)).uniform(*SPEEDS_MPS))


def walk_along_x(truth: PlantState, speed: float) -> Wish:
    """The command that leads a robot along x, back to y = 0 where it left it."""
    heading = float(np.clip(-MIDDLE_GAIN * truth.position_base_in_world[1], -1.0, 1.0))
    error = math.remainder(heading - base_yaw(truth), 2.0 * math.pi)
    turn = float(np.clip(HEADING_GAIN * error, -MOST_TURN_RPS, MOST_TURN_RPS))
    return Wish(mode=CommandMode.WALK, ahead_mps=speed, turn_rps=turn)


def median_or_none(values: Sequence[float]) -> float | None:
    """Median of some values; None where there are none."""
    return float(np.median(values)) if len(values) else None
