"""The command packet reaches the drive late."""

from dataclasses import dataclass

from saltus.arrays import Array, namespace
from saltus.effects.delay_line import LateCommand
from saltus.joint_command import JointCommand


@dataclass(frozen=True, kw_only=True)
class CommandDelay(LateCommand, name="command_delay"):
    """The whole packet is `delay` old when the drive uses it: targets, gains and feed-forward torque.

    Fields are averaged one by one over a step in which a packet arrives; where gains change in that very step the mean
    of the products differs from the product of the means, by one step at most.
    """

    def first(self, signal: JointCommand) -> Array:
        """The last packets, newest first, shape (..., length, 5, 12)."""
        return self._line.filled(_packet(signal))

    def apply(self, signal: JointCommand, time_s: Array, state: Array) -> tuple[JointCommand, Array]:
        """Delays every field by the same time."""
        del time_s
        late, line = self._line.pushed(_packet(signal), self.first(signal) if state is None else state)
        position, velocity, kp, kd, torque = (late[..., i, :] for i in range(5))
        return JointCommand(position=position, velocity=velocity, kp=kp, kd=kd, torque=torque), line


def _packet(command: JointCommand) -> Array:
    fields = [command.position, command.velocity, command.kp, command.kd, command.torque]
    return namespace(command.torque).stack(fields, axis=-2)
