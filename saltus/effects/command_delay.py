"""The command packet reaches the drive late."""

from dataclasses import dataclass

from saltus.effects.delay_line import History, LateCommand, delayed
from saltus.wire.messages import JointCommand


@dataclass(frozen=True, kw_only=True)
class CommandDelay(LateCommand, name="command_delay"):
    """The whole packet is `delay` old when the drive uses it: targets, gains and feed-forward torque.

    Fields are averaged one by one over a step in which a packet arrives; where gains change in that very step the mean
    of the products differs from the product of the means, by one step at most.
    """

    def apply(self, signal: JointCommand, time_s: float, state: History) -> tuple[JointCommand, History]:
        """Delays every field by the same time."""
        del time_s
        packet = (signal.position, signal.velocity, signal.kp, signal.kd, signal.torque)
        (position, velocity, kp, kd, torque), line = delayed(packet, state, self.delay, self.dt_s)
        return JointCommand(position=position, velocity=velocity, kp=kp, kd=kd, torque=torque), line
