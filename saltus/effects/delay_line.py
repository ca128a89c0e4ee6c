"""Fractional delay of a signal that is held between samples,
and the effects that delay a command.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from saltus.arrays import Array, Constant, Floats, Indices, namespace
from saltus.constants import PHYSICS_DT
from saltus.effects.effect import Drawable, Drawn, Effect, parameter, period
from saltus.joint_command import JointCommand


class DelayLine:
    """Makes of a signal what a receiver has of it `delay_s` later, averaged over the coming `dt_s`.

    A packet that arrives between two steps splits the step: the old value acts until then, the new
    one after. A plant that holds its input over a step is given their time-weighted mean, which has
    the right impulse and is continuous in the delay: with delay = (n + f) dt it is (1 - f) x[k - n]
    + f x[k - n - 1]. Signals have the shape (..., fields, values), a line of them (..., length,
    fields, values); a delay is one for all, or goes with values or robots.
    """

    def __init__(self, delay_s: Drawable, dt_s: float) -> None:
        self._delay_s, self._dt_s = delay_s, dt_s
        greatest = delay_s.greatest if isinstance(delay_s, Drawn) else float(np.max(delay_s))
        # 0.006 / 0.002 is not 3 in floating point: a thousandth of a sample is no delay that
        # anybody can mean
        self.length = math.floor(greatest / dt_s + 1e-3) + 2
        """Number of samples to remember."""
        self._ages = Constant(np.arange(self.length)[:, None, None])
        if not isinstance(delay_s, Drawn):
            steps = np.atleast_1d(delay_s) / dt_s
            steps = np.where(np.abs(steps - np.round(steps)) < 1e-3, np.round(steps), steps)
            self._fixed = Constant(self._weights_of(steps))

    def filled(self, signal: Array) -> Array:
        """The line of a receiver that has had this signal for long."""
        return namespace(signal).stack([signal] * self.length, axis=-3)

    def pushed(self, signal: Array, line: Array) -> tuple[Array, Array]:
        """Sample that the receiver has now, and the line for the next call:
        the last samples, newest first.
        """
        xp = namespace(signal)
        line = xp.concat([signal[..., None, :, :], line[..., :-1, :, :]], axis=-3)
        return xp.sum(self._weights(line) * line, axis=-3), line

    def _weights(self, line: Array) -> Array:
        if not isinstance(self._delay_s, Drawn):
            return self._fixed.like(line)
        return self._weights_of(
            namespace(line).clip(self._delay_s.read(line), 0.0, None) * (1.0 / self._dt_s)
        )

    def _weights_of(self, steps: Array) -> Array:
        """Weights of every sample, for delays in samples, shape (..., values or 1)."""
        xp, late = namespace(steps), steps[..., None, None, :]
        return xp.clip(1.0 - xp.abs(self._ages.like(late) - late), 0.0, None)


def held_late(ago: Callable[[Indices], Floats], steps: Floats) -> Floats:
    """Output of a `DelayLine` for a signal of which all samples are known, `steps` samples late.

    `ago` gives the sample that was there so many samples before.
    """
    whole = np.floor(steps).astype(np.int64)
    part = steps - whole
    return np.asarray((1.0 - part) * ago(whole) + part * ago(whole + 1))


@dataclass(frozen=True, kw_only=True)
class LateCommand(Effect[JointCommand], site="command"):
    """An effect by which part of a command, or all of it, is `delay` old when the drive uses it."""

    # searched up to 25 ms by published identification methods; hobby servos reach 130 ms
    delay: Drawable = parameter(
        unit="s", null=0.0, low=0.0, high=0.15, sought=(0.0, 0.06), per_joint=True
    )
    dt_s: float = period(PHYSICS_DT)
    """Period of the commands."""

    @cached_property
    def _line(self) -> DelayLine:
        return DelayLine(self.delay, self.dt_s)


@dataclass(frozen=True, kw_only=True)
class CommandDelay(LateCommand, name="command_delay"):
    """The whole packet is `delay` old when the drive uses it:
    targets, gains and feed-forward torque.

    Fields are averaged one by one over a step in which a packet arrives; where gains change in that
    very step the mean of the products differs from the product of the means, by one step at most.
    """

    def first(self, signal: JointCommand) -> Array:
        """The last packets, newest first, shape (..., length, 5, 12)."""
        return self._line.filled(_packet(signal))

    def apply(
        self, signal: JointCommand, time_s: Array, state: Array
    ) -> tuple[JointCommand, Array]:
        """Delays every field by the same time."""
        late, line = self._line.pushed(
            _packet(signal), self.first(signal) if state is None else state
        )
        position, velocity, kp, kd, torque = (late[..., i, :] for i in range(5))
        return JointCommand(position=position, velocity=velocity, kp=kp, kd=kd, torque=torque), line


def _packet(command: JointCommand) -> Array:
    fields = [command.position, command.velocity, command.kp, command.kd, command.torque]
    return namespace(command.torque).stack(fields, axis=-2)


@dataclass(frozen=True, kw_only=True)
class FeedforwardDelay(LateCommand, name="feedforward_delay"):
    """Feed-forward torque is `delay` late; the PD law is not. 10 ms (original)."""

    def first(self, signal: JointCommand) -> Array:
        """The last torques, newest first, shape (..., length, 1, 12):
        a drive has none before its first packet.
        """
        return self._line.filled(namespace(signal.torque).zeros_like(signal.torque)[..., None, :])

    def apply(
        self, signal: JointCommand, time_s: Array, state: Array
    ) -> tuple[JointCommand, Array]:
        """Delays the torque alone."""
        late, line = self._line.pushed(
            signal.torque[..., None, :], self.first(signal) if state is None else state
        )
        return replace(signal, torque=late[..., 0, :]), line
