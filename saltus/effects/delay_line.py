"""Fractional delay of a signal that is held between samples, and what effects that delay a command have in common."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from saltus.arrays import namespace
from saltus.constants import PHYSICS_DT
from saltus.effects.effect import Effect, Values, like, parameter, period
from saltus.wire.messages import JointCommand

History = tuple[tuple[Any, ...], ...] | None
"""Newest first: what came in at each of the last samples, as tuples of arrays. None before the first."""


@dataclass(frozen=True, kw_only=True)
class LateCommand(Effect[JointCommand], site="command"):
    """Part of a command, or all of it, is `delay` old when the drive uses it."""

    # searched up to 25 ms by published identification methods; hobby servos reach 130 ms
    delay: Values = parameter(unit="s", null=0.0, low=0.0, high=0.15, per_joint=True)
    dt_s: float = period(PHYSICS_DT)
    """Period of the commands."""


def delayed(signal: tuple[Any, ...], history: History, delay_s: Values, dt_s: float) -> tuple[tuple[Any, ...], History]:
    """Returns what a receiver makes of a signal that is `delay_s` old, averaged over the coming `dt_s`.

    A packet that arrives between two steps splits the step: the old value acts until then, the new one after. A plant
    that holds its input over a step is given their time-weighted mean, which has the right impulse and is continuous
    in the delay: with delay = (n + f) dt it is (1 - f) x[k - n] + f x[k - n - 1]. Before the first sample the receiver
    holds the first.

    The arrays of `signal`, shape (..., 12), travel together; a delay is one for all, or one per robot, shape (robots,
    1).
    """
    steps = np.asarray(delay_s) / dt_s
    # 0.006 / 0.002 is not 3 in floating point: a thousandth of a sample is no delay that anybody can mean
    steps = np.where(np.abs(steps - np.round(steps)) < 1e-3, np.round(steps), steps)
    length = math.floor(float(np.max(steps))) + 2
    past = history if history else (signal,) * length
    line = (signal, *past)[:length]
    if steps.ndim == 0:
        whole, part = divmod(float(steps), 1.0)
        newer, older = line[int(whole)], line[int(whole) + 1]
        if part == 0.0:
            return newer, line
        return tuple((1.0 - part) * a + part * b for a, b in zip(newer, older, strict=True)), line
    return tuple(_interpolated(samples, steps) for samples in zip(*line, strict=True)), line


def _interpolated(samples: tuple[Any, ...], steps: np.ndarray) -> Any:
    """Linear interpolation in a line of samples at one place per robot."""
    xp = namespace(samples[0])
    weights = [like(np.clip(1.0 - np.abs(steps - k), 0.0, 1.0), samples[0], xp) for k in range(len(samples))]
    total = weights[0] * samples[0]
    for weight, sample in zip(weights[1:], samples[1:], strict=True):
        total = total + weight * sample
    return total
