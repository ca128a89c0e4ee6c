"""From a joint command to the torque at the joint: the effects of an actuator in their physical order."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from saltus.effects.effect import Effect
from saltus.effects.order import ordered
from saltus.effects.signals import Drive
from saltus.messages import Floats, JointCommand

COMMAND_ORDER = ("command_delay", "feedforward_delay")
"""What happens to a packet until the drive uses it."""
TORQUE_ORDER = ("actuator_lag", "torque_speed_limit", "torque_saturation", "torque_gain")
"""What happens to the torque that the drive asks for; friction at the joint comes after these."""

ActuatorState = tuple[Any, ...]
"""States of the effects, in the order of the chain."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Torques:
    """What an actuator does and what it believes that it does, each of shape (..., 12) [Nm]."""

    applied: Floats
    """At the joint."""
    believed: Floats
    """What the drive reports (`tau_est`): the PD law and feed-forward before lag, limits and gain."""


@dataclass(frozen=True)
class ActuatorChain:
    """The effects of an actuator, applied in one fixed order, whatever the order in which they are given.

    command_delay, feedforward_delay, PD on the drive's own encoder, actuator_lag, torque_speed_limit,
    torque_saturation, torque_gain. Effects that are null are left out.

    Raises:
        ConfigError: an effect that is given twice, or that is not one of an actuator.
    """

    effects: tuple[Effect[Any], ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "effects", ordered(self.effects, COMMAND_ORDER + TORQUE_ORDER, "an actuator"))

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> ActuatorState:
        """State before the first command, for `batch` robots."""
        return tuple(effect.init(batch, rng) for effect in self.effects)

    def step(
        self, command: JointCommand, position: Floats, velocity: Floats, time_s: float, state: ActuatorState
    ) -> tuple[Torques, ActuatorState]:
        """Torque over the coming physics step.

        Args:
            command: sent now; shape (..., 12).
            position: of the joints as the drives measure it [rad], shape (..., 12).
            velocity: the same for velocity [rad/s].
            time_s: now, in the run's clock.
            state: what `init` or the last `step` returned.
        """
        states = []
        pending = list(zip(self.effects, state, strict=True))
        for effect, memory in [pair for pair in pending if pair[0].site == "command"]:
            command, memory = effect.apply(command, time_s, memory)
            states.append(memory)
        believed = proportional_derivative(command, position, velocity)
        drive = Drive(torque=believed, position=position, velocity=velocity)
        for effect, memory in [pair for pair in pending if pair[0].site == "torque"]:
            drive, memory = effect.apply(drive, time_s, memory)
            states.append(memory)
        return Torques(applied=drive.torque, believed=believed), tuple(states)


def proportional_derivative(command: JointCommand, position: Floats, velocity: Floats) -> Floats:
    """The law of the drive: kp (q_des - q) + kd (dq_des - dq) + tau_ff [Nm], shape (..., 12)."""
    return command.kp * (command.position - position) + command.kd * (command.velocity - velocity) + command.torque
