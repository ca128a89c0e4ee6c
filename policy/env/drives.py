"""The actuators of a training: the effects of a profile, with a delay and a strength that differ from robot to robot.

Effects hold one value for a whole run. In training the delay of feed-forward torque and the strength of the motors are
drawn anew for every episode of every robot, so they are arguments here; their laws are those of `FeedforwardDelay`
and `TorqueGain`. All else is the profile's own effects, as far as they need no memory.
"""

import logging
import math
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


class Drives:
    """From joint commands to torques, for a batch whose robots differ.

    Args:
        robot: Whose drives they are.
        longest_delay_s: No robot's delay is longer.
        profile: Its gain multiplies the strength. Its effects on torque that have no memory are applied as they are,
            friction as a torque that cannot turn a joint round within a step. Others are left out, with a warning.
    """

    def __init__(self, robot: Robot, longest_delay_s: float, profile: Profile) -> None:
        self.length = math.ceil(longest_delay_s / PHYSICS_DT - 1e-6) + 2
        """Number of feed-forward torques to remember."""
        kept = [e.fitted(robot) for e in profile.actuator if e.name not in DRAWN and e.name not in LEFT_OUT]
        torque, joint = (tuple(e for e in kept if e.site == site) for site in ("torque", "joint"))
        self._effects: tuple[Effect[Any], ...] = ordered(torque, TORQUE_ORDER, "an actuator")
        self._resisting: tuple[Effect[Any], ...] = ordered(joint, JOINT_ORDER, "an actuator")
        gains = [effect.gain for effect in profile.actuator if isinstance(effect, TorqueGain)] or [1.0]
        self._gain = Constant(np.broadcast_to(np.asarray(gains[0], dtype=np.float64), robot.armature.shape).copy())
        self._ages = Constant(range(self.length))
        self._reach = Constant(robot.armature / PHYSICS_DT)
        left_out = [effect.name for effect in profile.actuator if effect.name in LEFT_OUT]
        if left_out:
            logging.getLogger(__name__).warning("robots in training are without %s", ", ".join(left_out))

    def step(
        self, command: JointCommand, position: Array, velocity: Array, line: Array, delay_s: Array, strength: Array
    ) -> tuple[Array, Array]:
        """Torque over the coming tick, and the feed-forward torques to remember.

        Args:
            command: sent now, arrays (n, 12).
            position: of the joints [rad], shape (n, 12).
            velocity: of the joints [rad/s], shape (n, 12).
            line: Feed-forward torques of the last ticks, newest first [Nm], shape (n, length, 12).
            delay_s: of each robot, shape (n,).
            strength: of each robot, shape (n,).
        """
        xp = namespace(line)
        line = xp.concat([command.torque[:, None, :], line[:, :-1]], axis=1)
        distance = xp.abs(self._ages.like(line) - (delay_s * (1.0 / PHYSICS_DT))[:, None])
        weight = xp.clip(1.0 - distance, 0.0, None)
        late = xp.sum(weight[..., None] * line, axis=1)
        delayed = JointCommand(
            position=command.position, velocity=command.velocity, kp=command.kp, kd=command.kd, torque=late
        )
        believed = proportional_derivative(delayed, position, velocity)
        drive = Drive(torque=believed, position=position, velocity=velocity)
        for effect in self._effects:
            drive, _ = effect.apply(drive, 0.0, None)
        torque = drive.torque * self._gain.like(line) * strength[:, None]
        return torque - self._friction(velocity), line

    def _friction(self, velocity: Array) -> Array:
        """Torque against the motion, shape (n, 12): at most what stops the rotor within a step."""
        if not self._resisting:
            return namespace(velocity).zeros_like(velocity)
        xp = namespace(velocity)
        none = xp.zeros_like(velocity)
        resistance = Resistance(velocity=velocity, friction=none, damping=none, armature=none)
        for effect in self._resisting:
            resistance, _ = effect.apply(resistance, 0.0, None)
        speed = xp.abs(velocity)
        return xp.sign(velocity) * xp.minimum(
            resistance.friction + resistance.damping * speed, self._reach.like(velocity) * speed
        )
