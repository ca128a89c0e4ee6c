"""The command packet reaches the drive late."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from saltus.constants import PHYSICS_DT
from saltus.effects.delay_line import History, delayed
from saltus.effects.effect import Effect, Site, Values, parameter, period
from saltus.wire.messages import JointCommand


@dataclass(frozen=True, kw_only=True)
class CommandDelay(Effect[JointCommand]):
    """The whole packet is `delay` old when the drive uses it: targets, gains and feed-forward torque.

    Fields are averaged one by one over a step in which a packet arrives; where gains change in that very step the mean
    of the products differs from the product of the means, by one step at most.
    """

    name: ClassVar[str] = "command_delay"
    site: ClassVar[Site] = "command"

    # searched up to 25 ms by published identification methods; hobby servos reach 130 ms
    delay: Values = parameter(unit="s", null=0.0, low=0.0, high=0.15, per_joint=True)
    dt_s: float = period(PHYSICS_DT)
    """Period of the commands."""

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> History:
        """An empty line."""
        del batch, rng
        return ()

    def apply(self, signal: JointCommand, time_s: float, state: History) -> tuple[JointCommand, History]:
        """Delays every field by the same time."""
        del time_s
        packet = (signal.position, signal.velocity, signal.kp, signal.kd, signal.torque)
        (position, velocity, kp, kd, torque), line = delayed(packet, state, self.delay, self.dt_s)
        return JointCommand(position=position, velocity=velocity, kp=kp, kd=kd, torque=torque), line
