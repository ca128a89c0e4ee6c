"""Effects that add to one field of their signal, or scale it, and do nothing else."""

from dataclasses import dataclass

import numpy as np

from saltus.effects.body import (
    NOMINAL_CONTACT_TIME_CONSTANT_S,
    NOMINAL_FRICTION,
    NOMINAL_IMPEDANCE_DEPTH_M,
    NOMINAL_TOUCH_IMPEDANCE,
    BodyModel,
)
from saltus.effects.effect import Drawable, Effect, PerRobot, Values, parameter
from saltus.effects.signals import CameraView, Drive, JointState, Resistance


@dataclass(frozen=True, kw_only=True)
class TorqueGain(Effect[Drive], name="torque_gain", site="torque"):
    """A motor is stronger or weaker than its data sheet says: torque constant, gear efficiency."""

    # +-10 % is the usual range of domain randomisation
    gain: Drawable = parameter(
        unit="", null=1.0, low=0.0, high=2.0, sought=(0.3, 2.0), per_joint=True, scales="torque"
    )


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
class EncoderBias(Effect[JointState], name="encoder_bias", site="joint_state"):
    """The drive reads `bias` more than the joint's true angle.

    Log and PD law both see the reading.
    """

    # +-0.1 rad is what published identification methods allow
    bias: Values = parameter(
        unit="rad",
        null=0.0,
        low=-0.5,
        high=0.5,
        sought=(-0.3, 0.3),
        per_joint=True,
        adds_to="position",
    )


@dataclass(frozen=True, kw_only=True)
class VelocityScale(Effect[JointState], name="velocity_scale", site="joint_state"):
    """The drive reads `scale` times the joint's true velocity.

    Log and PD law both see the reading.
    """

    # 1.11 to 1.16 on a Go2
    scale: Values = parameter(
        unit="", null=1.0, low=0.2, high=5.0, sought=(0.3, 4.0), per_joint=True, scales="velocity"
    )


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
    """Feet and ground are softer than claimed: contacts give way like a critically damped spring of `time_constant`.

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
    """Feet of rubber: where they stand they resist being turned and rolled, and they stiffen as they are pressed.

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
    """A stand or a strap that holds a robot in the air lets its base roll, by `give` under 1 Nm, against `damping`.

    The base turns about the x axis of its frame. A robot that nothing holds has no such effect.
    """

    # the strap that held a Go2 gave 0.03 rad/Nm at least; by 10 a robot of 12 kg rolls freely
    give: PerRobot = parameter(unit="rad/Nm", null=0.0, low=0.0, high=10.0, adds_to="roll_give")
    # without a give it means nothing
    damping: PerRobot = parameter(
        unit="Nm s/rad", null=0.0, low=0.0, high=10.0, sought=(0.0, 5.0), adds_to="roll_damping"
    )


@dataclass(frozen=True, kw_only=True)
class CameraPitch(Effect[CameraView], name="camera_pitch", site="view"):
    """The camera is turned by `offset` about the trunk's left axis, nose down positive."""

    # 0.5 to 3 degrees on real robots
    offset: PerRobot = parameter(
        unit="rad", null=0.0, low=-0.5, high=0.5, sought=(-0.2, 0.2), adds_to="pitch"
    )


@dataclass(frozen=True, kw_only=True)
class CameraHeight(Effect[CameraView], name="camera_height", site="view"):
    """The optical centre is `offset` higher in the trunk's frame."""

    # 5 to 20 mm on real robots
    offset: PerRobot = parameter(
        unit="m", null=0.0, low=-0.3, high=0.3, sought=(-0.1, 0.1), adds_to=("position", 2)
    )


@dataclass(frozen=True, kw_only=True)
class CameraFov(Effect[CameraView], name="camera_fov", site="view"):
    """The tangent of each pixel's true angle to the optical axis is `scale` times the claimed one."""

    # 1 to 3 % on real robots; mistakes in cropping and resizing are the usual cause
    scale: PerRobot = parameter(
        unit="", null=1.0, low=0.5, high=2.0, sought=(0.8, 1.25), scales="tangent_scale"
    )
