"""Effects at a joint beside its drive: friction, inertia, springs and cables, stops, stiction."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from saltus.arrays import Array, namespace
from saltus.constants import PHYSICS_DT
from saltus.effects.effect import Drawable, Effect, Values, parameter, period
from saltus.effects.signals import DriveTorque, Resistance
from saltus.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class ViscousFriction(Effect[Resistance], name="viscous_friction", site="joint"):
    """Oil and bearings: a torque of `coefficient` times the joint's velocity against the motion."""

    # 0.1 to 0.4 Nm s/rad on drives of this class
    coefficient: Drawable = parameter(
        unit="Nm s/rad",
        null=0.0,
        low=0.0,
        high=10.0,
        sought=(0.0, 5.0),
        per_joint=True,
        adds_to="damping",
    )


@dataclass(frozen=True, kw_only=True)
class CoulombFriction(Effect[Resistance], name="coulomb_friction", site="joint"):
    """Dry friction: at most `torque` against the motion.

    At standstill, whatever holds the joint still.
    """

    # 0.05 to 0.8 Nm at the joints of robots of this class
    torque: Drawable = parameter(
        unit="Nm",
        null=0.0,
        low=0.0,
        high=20.0,
        sought=(0.0, 5.0),
        per_joint=True,
        adds_to="friction",
    )


@dataclass(frozen=True, kw_only=True)
class Armature(Effect[Resistance], name="armature", site="joint"):
    """The rotor, seen through its gear, has `added` more inertia than claimed.

    It turns with the joint alone.
    """

    # the rotors of a robot of 12 kg make 0.0020 at hip and thigh and 0.0045 at the calf
    # (manufacturers' models)
    added: Drawable = parameter(
        unit="kg m2",
        null=0.0,
        low=-0.0015,
        high=0.5,
        sought=(-1e-3, 0.1),
        per_joint=True,
        adds_to="armature",
    )


@dataclass(frozen=True, kw_only=True)
class JointSpring(Effect[DriveTorque], name="joint_spring", site="torque"):
    """A spring or a cable pulls with `torque` at the joint's zero angle,
    and by `stiffness` less with each rad.

    A `stiffness` of 0 is a pull that stays the same at all angles. The drive knows nothing of it.
    """

    # cables held 0.15 to 0.25 Nm at the joints of a Go2
    torque: Values = parameter(
        unit="Nm", null=0.0, low=-150.0, high=150.0, sought=(-10.0, 10.0), per_joint=True
    )
    stiffness: Values = parameter(
        unit="Nm/rad", null=0.0, low=0.0, high=50.0, sought=(0.0, 20.0), per_joint=True
    )
    dt_s: float = period(PHYSICS_DT)
    """Period of the torque."""

    def apply(self, signal: DriveTorque, time_s: Array, state: None) -> tuple[DriveTorque, None]:
        """Adds the pull at the angle halfway through the coming period:
        an older one would feed the joint energy.
        """
        pull, stiffness = (self.value(name, signal.torque) for name in ("torque", "stiffness"))
        halfway = signal.position + 0.5 * self.dt_s * signal.velocity
        return replace(signal, torque=signal.torque + (pull - stiffness * halfway)), None


@dataclass(frozen=True, kw_only=True)
class EndStop(Effect[DriveTorque], name="end_stop", site="torque"):
    """A joint's stops are soft and begin early:
    beyond `upper` or below `lower` a spring of `stiffness` pushes it back.

    The limits of the robot's model, which are hard, stay.
    """

    # the calves of a Go2 lean on a stop that begins 0.09 rad before the model's limit
    upper: Values = parameter(unit="rad", null=math.inf, low=-7.0, high=7.0, per_joint=True)
    lower: Values = parameter(unit="rad", null=-math.inf, low=-7.0, high=7.0, per_joint=True)
    # that of a Go2's calves; without a stop it means nothing
    stiffness: Values = field(
        default=340.0,
        metadata={
            "unit": "Nm/rad",
            "low": 1.0,
            "high": 3000.0,
            "sought": (0.0, 3000.0),
            "per_joint": True,
        },
    )
    dt_s: float = period(PHYSICS_DT)
    """Period of the torque."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.all(np.asarray(self.lower) < np.asarray(self.upper)):
            raise ConfigError(
                f"{self.name}: lower = {self.lower!r} must be below upper = {self.upper!r} rad"
            )

    def apply(self, signal: DriveTorque, time_s: Array, state: None) -> tuple[DriveTorque, None]:
        """Adds the push at the angle halfway through the coming period:
        an older one would feed the joint energy.
        """
        xp = namespace(signal.torque)
        upper, lower, stiffness = (
            self.value(name, signal.torque) for name in ("upper", "lower", "stiffness")
        )
        halfway = signal.position + 0.5 * self.dt_s * signal.velocity
        beyond = xp.clip(halfway - upper, 0.0, math.inf) - xp.clip(lower - halfway, 0.0, math.inf)
        return replace(signal, torque=signal.torque - stiffness * beyond), None


FADED = 30.0
"""Exponent beyond which the Stribeck curve counts as zero: exp(-30) is 1e-13, and float32
underflows later."""


@dataclass(frozen=True, kw_only=True)
class Stiction(Effect[Resistance], name="stiction", site="joint"):
    """Friction above the Coulomb level: `breakaway` at standstill,
    times exp(-(v / stribeck_velocity)^2) in motion.
    """

    # breakaway torque is 1.1 to 2 times the Coulomb level on drives of this class
    breakaway: Values = parameter(
        unit="Nm", null=0.0, low=0.0, high=20.0, sought=(0.0, 5.0), per_joint=True
    )
    # stick and slip are seen below 0.1 rad/s; without a breakaway torque it means nothing
    stribeck_velocity: Values = field(
        default=0.1,
        metadata={
            "unit": "rad/s",
            "low": 1e-3,
            "high": 10.0,
            "sought": (0.01, 2.0),
            "per_joint": True,
        },
    )

    def apply(self, signal: Resistance, time_s: Array, state: None) -> tuple[Resistance, None]:
        """Adds to the friction."""
        xp = namespace(signal.friction)
        width, breakaway = (
            self.value(name, signal.friction) for name in ("stribeck_velocity", "breakaway")
        )
        share = xp.exp(-xp.clip((signal.velocity / width) ** 2, 0.0, FADED))
        return replace(signal, friction=signal.friction + breakaway * share), None
