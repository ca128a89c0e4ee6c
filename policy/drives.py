"""The actuators of a training: the effects of a profile, with a delay and a strength that differ from robot to robot.

Effects hold one value for a whole run. In training the delay of feed-forward torque and the strength of the motors are
drawn anew for every episode of every robot, so they are arguments here; their laws are those of `FeedforwardDelay`
and `TorqueGain`. All else is the profile's own effects.
"""

import math
from typing import Any

from saltus import go1
from saltus.arrays import Array, Constant, namespace
from saltus.effects.chain import TORQUE_ORDER, proportional_derivative
from saltus.effects.effect import Effect
from saltus.effects.order import ordered
from saltus.effects.profile import GO1, Profile
from saltus.effects.signals import Drive
from saltus.messages import JointCommand


class Drives:
    """From joint commands to torques, for a batch whose robots differ.

    Args:
        longest_delay_s: No robot's delay is longer.
        profile: Its effects on torque that have no memory are applied as they are.
    """

    def __init__(self, longest_delay_s: float, profile: Profile = GO1) -> None:
        self.length = math.ceil(longest_delay_s / go1.PHYSICS_DT - 1e-6) + 2
        """Number of feed-forward torques to remember."""
        torque = [effect for effect in profile.actuator if effect.site == "torque" and effect.name != "torque_gain"]
        self._effects: tuple[Effect[Any], ...] = ordered(tuple(torque), TORQUE_ORDER, "an actuator")
        self._ages = Constant(range(self.length))

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
        distance = xp.abs(self._ages.like(line) - (delay_s * (1.0 / go1.PHYSICS_DT))[:, None])
        weight = xp.clip(1.0 - distance, 0.0, None)
        late = xp.sum(weight[..., None] * line, axis=1)
        delayed = JointCommand(
            position=command.position, velocity=command.velocity, kp=command.kp, kd=command.kd, torque=late
        )
        believed = proportional_derivative(delayed, position, velocity)
        drive = Drive(torque=believed, position=position, velocity=velocity)
        for effect in self._effects:
            drive, _ = effect.apply(drive, 0.0, None)
        return drive.torque * strength[:, None], line
