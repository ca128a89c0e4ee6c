"""The robot's body and the ground under it, and the effects that change them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from saltus.arrays import Array
from saltus.effects.effect import Effect, PerRobot, parameter

NOMINAL_FRICTION = 0.8
"""Coefficient between soles and ground that the model claims: rubber on concrete, middle of what
trials draw."""
NOMINAL_CONTACT_TIME_CONSTANT_S = 0.005
"""Time constant of the contacts that the model claims: nearly as stiff as a time step of 2 ms
allows (the engine wants two)."""
NOMINAL_TOUCH_IMPEDANCE = 0.95
"""Impedance of the contacts that the model claims, where they begin; the engine's default is
0.9."""
NOMINAL_IMPEDANCE_DEPTH_M = 0.001
"""Depth at which they have reached their full impedance; the engine's default."""
LEAST_TURNING_M = 1e-5
"""Friction against turning and rolling that is there in any case; the engine's least."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyModel:
    """The parts of a robot's model that effects may change; one robot, or a batch.

    Sites "model" and "stand".

    Those of shape (...) but the payload may be one number for all robots of a batch.
    """

    payload_kg: Array
    """Mass on top of the trunk [kg], shape (...); negative where the trunk is lighter than
    claimed."""
    com_shift: Array
    """Added to the trunk's centre of mass [m], base frame, shape (..., 3)."""
    inertia_scale: Array
    """Inertia scale of the trunk about its centre of mass, true over claimed, shape (...)."""
    friction: Array
    """Coefficient of sliding friction between robot and terrain, shape (...)."""
    contact_time_constant: Array
    """Contact time constant of the contacts, which are critically damped [s], shape (...)."""
    touch_impedance: Array
    """Touch impedance of the contacts where they begin: 1 is rigid, shape (...)."""
    impedance_depth: Array
    """Depth at which they have reached their full impedance [m], shape (...)."""
    torsion: Array
    """Coefficient of friction against turning about the normal of a contact [m], shape (...)."""
    rolling: Array
    """Coefficient of friction against rolling [m], shape (...)."""
    roll_give: Array = 0.0
    """By how much the base of a held robot rolls under 1 Nm [rad/Nm], shape (...); 0 is rigid."""
    roll_damping: Array = 0.0
    """Roll damping of that motion [Nm s/rad], shape (...)."""


def claimed_body(
    batch: tuple[int, ...] = (),
    *,
    friction: ArrayLike = NOMINAL_FRICTION,
    payload_kg: ArrayLike = 0.0,
    com_shift: ArrayLike = (0.0, 0.0, 0.0),
    inertia_scale: ArrayLike = 1.0,
    contact_time_constant: ArrayLike = NOMINAL_CONTACT_TIME_CONSTANT_S,
    torsion: ArrayLike = LEAST_TURNING_M,
    rolling: ArrayLike = LEAST_TURNING_M,
) -> BodyModel:
    """The model without effects, or with values given directly; all broadcast.

    Args:
        batch: Leading dimensions.
        friction: Coefficient, to `batch`.
        payload_kg: Mass on top of the trunk [kg], to `batch`.
        com_shift: Added to the trunk's centre of mass [m], base frame, to (*batch, 3).
        inertia_scale: Of the trunk, to `batch`.
        contact_time_constant: Of the contacts [s], to `batch`.
        torsion: Friction against turning on the spot [m], to `batch`.
        rolling: Friction against rolling [m], to `batch`.
    """
    return BodyModel(
        payload_kg=_filled(payload_kg, batch),
        com_shift=_filled(com_shift, (*batch, 3)),
        inertia_scale=_filled(inertia_scale, batch),
        friction=_filled(friction, batch),
        contact_time_constant=_filled(contact_time_constant, batch),
        touch_impedance=_filled(NOMINAL_TOUCH_IMPEDANCE, batch),
        impedance_depth=_filled(NOMINAL_IMPEDANCE_DEPTH_M, batch),
        torsion=_filled(torsion, batch),
        rolling=_filled(rolling, batch),
        roll_give=_filled(0.0, batch),
        roll_damping=_filled(0.0, batch),
    )


def _filled(value: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    return np.broadcast_to(np.asarray(value, dtype=np.float64), shape).copy()


@dataclass(frozen=True, kw_only=True)
class PayloadMass(Effect[BodyModel], name="payload_mass", site="model"):
    """A box of `mass` on top of the trunk, beyond what is claimed.

    Negative where the trunk is lighter.
    """

    # camera and computer weigh 1 kg; robots of this class carry up to 5 kg
    mass: PerRobot = parameter(
        unit="kg", null=0.0, low=-3.0, high=10.0, sought=(-2.5, 8.0), adds_to="payload_kg"
    )


@dataclass(frozen=True, kw_only=True)
class ComOffset(Effect[BodyModel], name="com_offset", site="model"):
    """The centre of mass of the trunk alone is off by (`x`, `y`, `z`) in the base frame."""

    # +-2 to 5 cm of domain randomisation; the trunk's half length is 0.19 m
    x: PerRobot = parameter(
        unit="m", null=0.0, low=-0.19, high=0.19, sought=(-0.1, 0.1), adds_to=("com_shift", 0)
    )
    y: PerRobot = parameter(unit="m", null=0.0, low=-0.1, high=0.1, adds_to=("com_shift", 1))
    z: PerRobot = parameter(unit="m", null=0.0, low=-0.1, high=0.1, adds_to=("com_shift", 2))


@dataclass(frozen=True, kw_only=True)
class BaseInertia(Effect[BodyModel], name="base_inertia", site="model"):
    """The trunk's moments of inertia about its centre of mass are `scale` times what is claimed."""

    # +-20 % of domain randomisation, with room for cables and a battery that is left out
    scale: PerRobot = parameter(unit="", null=1.0, low=0.3, high=3.0, scales="inertia_scale")


@dataclass(frozen=True, kw_only=True)
class FootFriction(Effect[BodyModel], name="foot_friction", site="model"):
    """The coefficient of friction is `coefficient` where the model claims its nominal 0.8.

    It scales what is there: a trial that draws another ground keeps the ratio.
    """

    # 0.4 to 1.0 on indoor floors; ice to rubber on dry asphalt
    coefficient: PerRobot = parameter(
        unit="", null=NOMINAL_FRICTION, low=0.05, high=2.0, sought=(0.1, 1.6), scales="friction"
    )


@dataclass(frozen=True, kw_only=True)
class ContactCompliance(Effect[BodyModel], name="contact_compliance", site="model"):
    """Feet and ground are softer than claimed:
    contacts give way like a critically damped spring of `time_constant`.

    A foot that lands at 2 m/s sinks by 2 to 10 mm; that is 4 to 20 ms.
    """

    # the engine takes no less than two time steps of 2 ms
    time_constant: PerRobot = parameter(
        unit="s",
        null=NOMINAL_CONTACT_TIME_CONSTANT_S,
        low=0.004,
        high=0.1,
        sought=(0.004, 0.05),
        scales="contact_time_constant",
    )


@dataclass(frozen=True, kw_only=True)
class SoftFeet(Effect[BodyModel], name="soft_feet", site="model"):
    """Feet of rubber: where they stand they resist being turned and rolled,
    and they stiffen as they are pressed.

    `torsion` and `rolling` are torques over the force on the ground; `touch` is the impedance of a
    contact where it begins, 1 is rigid, and `depth` where it is whole.
    """

    # 0.02 and 0.01 m are those of the feet of MuJoCo Menagerie's Go1; those of a rubber ball of 2
    # cm are below 0.02
    torsion: PerRobot = parameter(unit="m", null=0.0, low=0.0, high=0.2, adds_to="torsion")
    rolling: PerRobot = parameter(unit="m", null=0.0, low=0.0, high=0.1, adds_to="rolling")
    # the same feet have 0.015 and 0.022 m
    touch: PerRobot = parameter(
        unit="", null=NOMINAL_TOUCH_IMPEDANCE, low=0.001, high=0.999, scales="touch_impedance"
    )
    depth: PerRobot = parameter(
        unit="m", null=NOMINAL_IMPEDANCE_DEPTH_M, low=1e-4, high=0.05, scales="impedance_depth"
    )

    @property
    def resists_turning(self) -> bool:
        """True where contacts need more than normal and sliding forces."""
        return bool(
            np.any(np.not_equal(self.torsion, 0.0)) or np.any(np.not_equal(self.rolling, 0.0))
        )


@dataclass(frozen=True, kw_only=True)
class BaseRoll(Effect[BodyModel], name="base_roll", site="stand"):
    """A stand or a strap that holds a robot in the air lets its base roll,
    by `give` under 1 Nm, against `damping`.

    The base turns about the x axis of its frame. A robot that nothing holds has no such effect.
    """

    # the strap that held a Go2 gave 0.03 rad/Nm at least; by 10 a robot of 12 kg rolls freely
    give: PerRobot = parameter(unit="rad/Nm", null=0.0, low=0.0, high=10.0, adds_to="roll_give")
    # without a give it means nothing
    damping: PerRobot = parameter(
        unit="Nm s/rad", null=0.0, low=0.0, high=10.0, sought=(0.0, 5.0), adds_to="roll_damping"
    )
