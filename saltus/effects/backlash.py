"""Play between a drive and its joint."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from saltus.arrays import Array, Constant, namespace
from saltus.effects.effect import Effect, Site, Values, like, parameter, period
from saltus.effects.signals import Drive
from saltus.go1 import ARMATURE, PHYSICS_DT

Play = tuple[Array, Array] | tuple[()]
"""How far the motor is ahead of the joint [rad], and how fast it gets ahead [rad/s]; empty before the first torque."""


@dataclass(frozen=True, kw_only=True)
class Backlash(Effect[Drive]):
    """The motor turns freely against the joint within a gap of `width`, and pushes it at either end.

    Drive and encoder of the PD law are on the motor's side; what is logged is on the joint's. Inside the gap the joint
    feels no torque, and the rotor is driven alone. A plant keeps the rotor's inertia at the joint for those few
    milliseconds.
    """

    name: ClassVar[str] = "backlash"
    site: ClassVar[Site] = "torque"

    # 0.3 to 1 degree at the knee linkage of robots of this class
    width: Values = parameter(unit="rad", null=0.0, low=0.0, high=0.3, per_joint=True)
    dt_s: float = period(PHYSICS_DT)
    """Period of the torque."""

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> Play:
        """Empty: the first torque is taken to have been there for long."""
        del batch, rng
        return ()

    def apply(self, signal: Drive, time_s: float, state: Play) -> tuple[Drive, Play]:
        """Transmits the torque where motor and joint touch; the state is the play over the coming period."""
        del time_s
        torque = signal.torque
        xp = namespace(torque)
        half = 0.5 * like(self.width, torque, xp)
        if not state:
            return signal, (xp.sign(torque) * half, xp.zeros_like(torque))
        offset, rate = state
        # 1. the rotor alone over one period, from where it is
        acceleration = torque / _ROTOR.like(torque)
        free = offset + self.dt_s * rate + 0.5 * self.dt_s**2 * acceleration
        # 2. it stays or arrives at an end, or it is under way
        ahead = xp.minimum(xp.maximum(free, -half + 0.0 * free), half + 0.0 * free)
        touches = (xp.abs(free) >= half) & (torque * free >= 0.0)
        zero = xp.zeros_like(torque)
        rate = xp.where(touches, zero, rate + self.dt_s * acceleration)
        return replace(signal, torque=xp.where(touches, torque, zero)), (ahead, rate)


_ROTOR = Constant(ARMATURE)
