"""From a joint command to the torque at the joint:
the effects of an actuator in their physical order; IMU and body.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypeAlias

from saltus.arrays import Array, Floats, Joints, namespace
from saltus.effects.backlash import Backlash
from saltus.effects.body import (
    BaseInertia,
    BaseRoll,
    ComOffset,
    ContactCompliance,
    FootFriction,
    PayloadMass,
    SoftFeet,
)
from saltus.effects.delay_line import CommandDelay, FeedforwardDelay
from saltus.effects.effect import Signal
from saltus.effects.encoders import EncoderBias, EncoderQuantisation, VelocityFilter, VelocityScale
from saltus.effects.imu import ImuBias, ImuLatency, ImuReading
from saltus.effects.joint_loads import (
    Armature,
    CoulombFriction,
    EndStop,
    JointSpring,
    Stiction,
    ViscousFriction,
)
from saltus.effects.motors import (
    ActuatorLag,
    BatterySag,
    TorqueGain,
    TorqueSaturation,
    TorqueSpeedLimit,
    VoltageSag,
)
from saltus.effects.signal_chain import Chain, Order, SignalChain, apply_effect, chosen_of
from saltus.effects.signals import DriveTorque, EncoderReading, Resistance
from saltus.joint_command import JointCommand
from saltus.robots.robot import Robot

COMMAND_ORDER: Order = (CommandDelay, FeedforwardDelay)
"""Effects on a packet until the drive uses it."""
SENSOR_ORDER: Order = (EncoderBias, EncoderQuantisation, VelocityFilter, VelocityScale)
"""Effects on the motion of a joint until the drive knows it."""
TORQUE_ORDER: Order = (
    ActuatorLag,
    TorqueSpeedLimit,
    TorqueSaturation,
    TorqueGain,
    BatterySag,
    VoltageSag,
    Backlash,
    JointSpring,
    EndStop,
)
"""Effects on the torque that the drive asks for, and other torques at the joint."""
JOINT_ORDER: Order = (ViscousFriction, CoulombFriction, Stiction, Armature)
"""Effects that resist the motion at the joint."""

ActuatorState = tuple[Any, ...]
ImuMemory: TypeAlias = tuple[ImuReading, tuple[object, ...]]
"""The reading of an IMU, and the states of its effects."""
"""States of the effects, in the order of the chain."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Torques:
    """The torque that an actuator gives and the one that it reports,
    each of shape (..., 12) [Nm].
    """

    applied: Joints
    """At the joint."""
    believed: Joints
    """The torque that the drive reports (`tau_est`): the PD law and feed-forward before lag, limits
    and gain."""
    resistance: Resistance | None = None
    """For the physics to integrate over the coming step; None where nothing resists the joint."""


@dataclass(frozen=True)
class ImuChain(SignalChain):
    """Effects between the motion of the base and the readings of its IMU,
    once a physics step: errors first, then lateness.
    """

    order: ClassVar[Order] = (ImuBias, ImuLatency)
    owner: ClassVar[str] = "an IMU"


@dataclass(frozen=True)
class BodyChain(SignalChain):
    """The effects on the robot's model."""

    order: ClassVar[Order] = (
        PayloadMass,
        ComOffset,
        BaseInertia,
        FootFriction,
        ContactCompliance,
        SoftFeet,
        BaseRoll,
    )
    owner: ClassVar[str] = "a body"

    @property
    def contact_dimensions(self) -> int:
        """Dimensions of a contact in the engine:
        3, or with friction against turning and rolling 6.
        """
        return (
            6
            if any(
                isinstance(effect, SoftFeet) and effect.resists_turning for effect in self.effects
            )
            else 3
        )


@dataclass(frozen=True)
class ActuatorChain(Chain):
    """The effects of an actuator.

    command_delay, feedforward_delay; encoder_bias, encoder_quantisation, velocity_filter,
    velocity_scale; PD on the drive's own encoder; actuator_lag, torque_speed_limit,
    torque_saturation, torque_gain, battery_sag, voltage_sag, backlash, joint_spring, end_stop;
    friction and armature.
    """

    order: ClassVar[Order] = COMMAND_ORDER + SENSOR_ORDER + TORQUE_ORDER + JOINT_ORDER
    owner: ClassVar[str] = "an actuator"

    def fitted(self, robot: Robot) -> "ActuatorChain":
        """The chain in the drives of a robot,
        from which its effects take what they do not say themselves.
        """
        return ActuatorChain(tuple(effect.fitted(robot) for effect in self.effects))

    @property
    def senses_otherwise(self) -> bool:
        """True where the drives measure another motion than that of the joints."""
        return any(
            effect.site == "joint_state"
            or (isinstance(effect, Backlash) and effect.is_logged_at_motor)
            for effect in self.effects
        )

    def measured(
        self,
        position: Joints,
        velocity: Joints,
        time_s: Array,
        state: ActuatorState,
        fresh: Array | None = None,
    ) -> EncoderReading:
        """Returns what the drives will measure in the next `step`.

        Arguments and `state` are those that it will get.
        """
        motion = self._on_its_side(
            EncoderReading(position=position, velocity=velocity), state, fresh, Backlash.logged
        )
        return self._pass("joint_state", motion, time_s, list(state), fresh)

    def step(
        self,
        command: JointCommand,
        position: Joints,
        velocity: Joints,
        time_s: Array,
        state: ActuatorState,
        fresh: Array | None = None,
    ) -> tuple[Torques, ActuatorState]:
        """Torque over the coming physics step.

        Args:
            command: sent now; shape (..., 12).
            position: of the joints [rad], shape (..., 12).
            velocity: of the joints [rad/s], shape (..., 12).
            time_s: now, in the run's clock.
            state: what `init` or the last `step` returned.
            fresh: robots that were just put back to the start, shape (...); None where there are
                none.
        """
        memories = list(state)
        # 1. the packet that the drive has by now
        command = self._pass("command", command, time_s, memories, fresh)
        # 2. its encoder
        motion = self._on_its_side(
            EncoderReading(position=position, velocity=velocity), state, fresh, Backlash.logged
        )
        motion = self._pass("joint_state", motion, time_s, memories, fresh)
        motion = self._on_its_side(motion, state, fresh, Backlash.seen)
        # 3. its law
        believed = proportional_derivative(command, motion.position, motion.velocity)
        # 4. what becomes of the torque on its way to the joint
        drive = DriveTorque(torque=believed, position=position, velocity=velocity)
        drive = self._pass("torque", drive, time_s, memories, fresh)
        # 5. what resists there
        resistance = self._resistance(velocity, time_s, memories)
        return Torques(applied=drive.torque, believed=believed, resistance=resistance), tuple(
            memories
        )

    def _pass(
        self, site: str, signal: Signal, time_s: Array, memories: list[object], fresh: Array | None
    ) -> Signal:
        for i, effect in enumerate(self.effects):
            if effect.site == site:
                signal, memories[i] = apply_effect(effect, signal, time_s, memories[i], fresh)
        return signal

    def _on_its_side(
        self,
        motion: EncoderReading,
        state: ActuatorState,
        fresh: Array | None,
        side: Callable[..., tuple[Array, Array]],
    ) -> EncoderReading:
        """The motion on another side of the play:
        that of the logged encoder, or that of the PD law's, the motor's.
        """
        for effect, memory in zip(self.effects, state, strict=True):
            if isinstance(effect, Backlash) and memory:
                position, velocity = side(effect, motion.position, motion.velocity, memory)
                there = EncoderReading(position=position, velocity=velocity)
                return there if fresh is None else chosen_of(fresh, motion, there)
        return motion

    def _resistance(
        self, velocity: Joints, time_s: Array, memories: list[Any]
    ) -> Resistance | None:
        resisting = [effect for effect in self.effects if effect.site == "joint"]
        play = [
            (e, memory)
            for e, memory in zip(self.effects, memories, strict=True)
            if isinstance(e, Backlash)
        ]
        if not resisting and not play:
            return None
        none = namespace(velocity).zeros_like(velocity)
        resistance = Resistance(velocity=velocity, friction=none, damping=none, armature=none)
        for effect in resisting:
            resistance, _ = effect.apply(resistance, time_s, None)
        for backlash, memory in play:
            resistance = replace(
                resistance, armature=resistance.armature - backlash.missing(memory)
            )
        return resistance


def proportional_derivative(command: JointCommand, position: Floats, velocity: Floats) -> Floats:
    """The law of the drive: kp (q_des - q) + kd (dq_des - dq) + tau_ff [Nm], shape (..., 12)."""
    return (
        command.kp * (command.position - position)
        + command.kd * (command.velocity - velocity)
        + command.torque
    )
