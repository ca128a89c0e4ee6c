"""Play between a drive and its joint."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from saltus.arrays import Array, Constant, namespace
from saltus.constants import PHYSICS_DT
from saltus.effects.effect import Drawn, Effect, Values, from_robot, parameter, period
from saltus.effects.signals import DriveTorque

BacklashState = tuple[Array, Array, Array, Array, Array]
"""How far the motor is ahead of the joint [rad], how fast it gets ahead [rad/s], whether both touch
over the coming step, and the joint's velocity [rad/s] and acceleration [rad/s^2] as last seen."""


@dataclass(frozen=True, kw_only=True)
class Backlash(Effect[DriveTorque], name="backlash", site="torque"):
    """The motor turns freely against the joint within a gap of `width`,
    and pushes it at either end.

    Drive, encoder of the PD law and rotor are on the motor's side; what is logged is on the
    joint's, unless `motor_side` says otherwise. In contact both move as one, until the rotor would
    have to pull. Inside the gap the joint feels neither torque nor rotor; where the gap ends, the
    rotor's momentum goes to the joint, without rebound.
    """

    # 0.3 to 1 degree at the knee linkage of robots of this class
    width: Values = parameter(
        unit="rad", null=0.0, low=0.0, high=0.3, sought=(0.0, 0.15), per_joint=True
    )
    # one encoder on the motor serves law and log in most drives, two encoders in others
    motor_side: Values = parameter(unit="", null=0.0, low=0.0, high=1.0, per_joint=True)
    """Where the logged encoder sits: 0 at the joint, 1 at the motor."""
    dt_s: float = period(PHYSICS_DT)
    """Period of the torque."""
    # inertia of the rotors; by default the robot's armature
    rotor: Values | None = from_robot("armature", unit="kg m^2", high=10.0)

    @property
    def is_logged_at_motor(self) -> bool:
        """True where any joint's log is not that of the joint's own side."""
        return isinstance(self.motor_side, Drawn) or bool(
            np.any(np.asarray(self.motor_side) != 0.0)
        )

    @cached_property
    def _rotor(self) -> Constant:
        return Constant(self.of_robot("rotor"))

    def first(self, signal: DriveTorque) -> BacklashState:
        """The first torque has been there for long:
        the motor pushes the joint at one end of the gap.
        """
        xp, half = namespace(signal.torque), 0.5 * self.value("width", signal.torque)
        zero = xp.zeros_like(signal.torque)
        return (
            xp.where(signal.torque < 0.0, -half + zero, half + zero),
            zero,
            zero == zero,
            signal.velocity,
            zero,
        )

    def apply(
        self, signal: DriveTorque, time_s: Array, state: BacklashState | None
    ) -> tuple[DriveTorque, BacklashState]:
        """Transmits the torque where motor and joint touch.

        The state is the play over the coming period.
        """
        torque = signal.torque
        xp = namespace(torque)
        half = 0.5 * self.value("width", torque)
        velocity, rotor = signal.velocity, self._rotor.like(torque)
        zero = xp.zeros_like(torque)
        offset, rate, touched, before, expected = state or self.first(signal)
        # 1. what the joint did over the last step, in place of what was expected of it
        turning = (velocity - before) / self.dt_s
        surprise = xp.where(touched, zero, self.dt_s * (expected - turning))
        offset, rate = offset + 0.5 * self.dt_s * surprise, rate + surprise
        # 2. rotors that would have to pull leave; those under way go on
        leaves = touched & ((torque - rotor * turning) * offset < 0.0)
        is_free = leaves | ~touched
        ahead = rate + self.dt_s * (torque / rotor - turning)
        reached = xp.where(is_free, offset + 0.5 * self.dt_s * (rate + ahead), offset)
        # 3. those that arrive bring their momentum
        arrives = is_free & (xp.abs(reached) >= half)
        touches = arrives | ~is_free
        pushed = xp.where(touches, torque + xp.where(arrives, rotor * rate / self.dt_s, zero), zero)
        end = xp.minimum(xp.maximum(reached, -half + zero), half + zero)
        return replace(signal, torque=pushed), (
            end,
            xp.where(touches, zero, ahead),
            touches,
            velocity,
            turning,
        )

    def logged(self, position: Array, velocity: Array, state: BacklashState) -> tuple[Array, Array]:
        """Angles and velocities on the side of the logged encoder, for those of the joints."""
        share = self.value("motor_side", position)
        return position + share * state[0], velocity + share * state[1]

    def seen(self, position: Array, velocity: Array, state: BacklashState) -> tuple[Array, Array]:
        """Angles and velocities on the motor's side,
        for those on the side of the logged encoder.
        """
        rest = 1.0 - self.value("motor_side", position)
        return position + rest * state[0], velocity + rest * state[1]

    def missing(self, state: BacklashState) -> Array:
        """Inertia that the joint lacks over the coming step,
        as the rotor turns without it [kg m^2].
        """
        _, rate, touches, _, _ = state
        xp = namespace(rate)
        return xp.where(touches, xp.zeros_like(rate), self._rotor.like(rate))
