"""The actuators of a training: the effects of a profile, with a delay and a strength that differ from robot to robot.

Effects hold one value for a whole run. In training the delay of feed-forward torque and the strength of the motors are
drawn anew for every episode of every robot, so they are arguments here; their laws are those of `FeedforwardDelay`
and `TorqueGain`. All else is the profile's own effects, as far as they need no memory.
"""

import logging
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from saltus.arrays import Array, Constant, namespace
from saltus.constants import PHYSICS_DT
from saltus.effects.chain import JOINT_ORDER, TORQUE_ORDER, proportional_derivative
from saltus.effects.effect import Effect
from saltus.effects.offsets_and_factors import TorqueGain
from saltus.effects.order import ordered
from saltus.effects.profile import Profile
from saltus.effects.signals import Drive, Resistance
from saltus.robots.robot import Robot
from saltus.wire.messages import JointCommand

DRAWN = ("torque_gain", "feedforward_delay")
"""Effects whose values are drawn for each robot."""
LEFT_OUT = (
    "command_delay", "actuator_lag", "battery_sag", "backlash", "armature",
    "encoder_bias", "encoder_quantisation", "velocity_filter",
)  # fmt: skip
"""Effects with a memory, or on what the batch has no place for: a policy meets them in roll-outs, not in training."""


COMMAND = 60
"""Numbers in a command: position, velocity, two gains and torque of twelve joints."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointDraws:
    """What resists in the joints of each robot besides the profile's effects, arrays of shape (n,)."""

    friction: Array
    """Dry [Nm]."""
    damping: Array
    """Viscous [Nm s/rad]."""
    armature: Array
    """True inertia of the rotors over that of the model."""


class Drives:
    """From joint commands to torques, for a batch whose robots differ.

    Args:
        robot: Whose drives they are.
        longest_delay_s: No robot's delay is longer.
        profile: Its gain multiplies the strength. Its effects on torque that have no memory are applied as they are,
            friction as a torque that cannot turn a joint round within a step. Others are left out, with a warning.
        longest_command_delay_s: No robot's whole commands are later; 0 where none are.
    """

    def __init__(
        self, robot: Robot, longest_delay_s: float, profile: Profile, longest_command_delay_s: float = 0.0
    ) -> None:
        self.length = _ticks(longest_delay_s)
        """Number of feed-forward torques to remember."""
        self.commands = _ticks(longest_command_delay_s) if longest_command_delay_s > 0.0 else 0
        """Number of whole commands to remember."""
        kept = [e.fitted(robot) for e in profile.actuator if e.name not in DRAWN and e.name not in LEFT_OUT]
        torque, joint = (tuple(e for e in kept if e.site == site) for site in ("torque", "joint"))
        self._effects: tuple[Effect[Any], ...] = ordered(torque, TORQUE_ORDER, "an actuator")
        self._resisting: tuple[Effect[Any], ...] = ordered(joint, JOINT_ORDER, "an actuator")
        gains = [effect.gain for effect in profile.actuator if isinstance(effect, TorqueGain)] or [1.0]
        self._gain = Constant(np.broadcast_to(np.asarray(gains[0], dtype=np.float64), robot.armature.shape).copy())
        self._ages, self._command_ages = Constant(range(self.length)), Constant(range(self.commands))
        self._reach = Constant(robot.armature / PHYSICS_DT)
        left_out = [effect.name for effect in profile.actuator if effect.name in LEFT_OUT]
        if left_out:
            logging.getLogger(__name__).warning("robots in training are without %s", ", ".join(left_out))

    def late(self, command: JointCommand, line: Array, delay_s: Array, fresh: Array) -> tuple[JointCommand, Array]:
        """The command that each drive has by now, and those to remember; the law of `CommandDelay`.

        Args:
            command: sent now, arrays (n, 12).
            line: Commands of the last ticks, newest first, shape (n, commands, COMMAND).
            delay_s: of each robot, shape (n,).
            fresh: Robots that had no command before, bool, shape (n,).
        """
        xp = namespace(line)
        sent = [command.position, command.velocity, command.kp, command.kd, command.torque]
        packet = xp.concat(sent, axis=-1)[:, None, :]
        line = xp.where(fresh[:, None, None], packet, xp.concat([packet, line[:, :-1]], axis=1))
        position, velocity, kp, kd, torque = (
            _aged(line[..., 12 * k : 12 * k + 12], self._command_ages, delay_s) for k in range(5)
        )
        return JointCommand(position=position, velocity=velocity, kp=kp, kd=kd, torque=torque), line

    def step(
        self,
        command: JointCommand,
        position: Array,
        velocity: Array,
        line: Array,
        delay_s: Array,
        strength: Array,
        joints: JointDraws | None = None,
    ) -> tuple[Array, Array]:
        """Torque over the coming tick, and the feed-forward torques to remember.

        Args:
            command: sent now, arrays (n, 12).
            position: of the joints [rad], shape (n, 12).
            velocity: of the joints [rad/s], shape (n, 12).
            line: Feed-forward torques of the last ticks, newest first [Nm], shape (n, length, 12).
            delay_s: of each robot, shape (n,).
            strength: of each robot, shape (n,).
            joints: what else resists.
        """
        xp = namespace(line)
        line = xp.concat([command.torque[:, None, :], line[:, :-1]], axis=1)
        late = _aged(line, self._ages, delay_s)
        delayed = JointCommand(
            position=command.position, velocity=command.velocity, kp=command.kp, kd=command.kd, torque=late
        )
        believed = proportional_derivative(delayed, position, velocity)
        drive = Drive(torque=believed, position=position, velocity=velocity)
        for effect in self._effects:
            drive, _ = effect.apply(drive, 0.0, None)
        torque = drive.torque * self._gain.like(line) * strength[:, None]
        return torque - self._friction(velocity, joints), line

    def _friction(self, velocity: Array, joints: JointDraws | None) -> Array:
        """Torque against the motion, shape (n, 12): at most what stops the rotor within a step."""
        if not self._resisting and joints is None:
            return namespace(velocity).zeros_like(velocity)
        xp = namespace(velocity)
        none = xp.zeros_like(velocity)
        resistance = Resistance(velocity=velocity, friction=none, damping=none, armature=none)
        for effect in self._resisting:
            resistance, _ = effect.apply(resistance, 0.0, None)
        friction, damping, reach = resistance.friction, resistance.damping, self._reach.like(velocity)
        if joints is not None:
            friction, damping = friction + joints.friction[:, None], damping + joints.damping[:, None]
            reach = reach * joints.armature[:, None]
        speed = xp.abs(velocity)
        return xp.sign(velocity) * xp.minimum(friction + damping * speed, reach * speed)


def _ticks(longest_delay_s: float) -> int:
    return math.ceil(longest_delay_s / PHYSICS_DT - 1e-6) + 2


def _aged(line: Array, ages: Constant, delay_s: Array) -> Array:
    """What of a line of samples, newest first, is `delay_s` old, shape (n, 12); between two samples, their mean."""
    xp = namespace(line)
    distance = xp.abs(ages.like(line) - (delay_s * (1.0 / PHYSICS_DT))[:, None])
    weight = xp.clip(1.0 - distance, 0.0, None)
    return xp.sum(weight[..., None] * line, axis=1)
