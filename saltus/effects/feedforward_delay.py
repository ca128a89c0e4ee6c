"""The feed-forward torque takes force later than the rest of its packet."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from saltus.constants import PHYSICS_DT
from saltus.effects.delay_line import History, delayed
from saltus.effects.effect import Effect, Site, Values, parameter, period
from saltus.wire.messages import JointCommand


@dataclass(frozen=True, kw_only=True)
class FeedforwardDelay(Effect[JointCommand]):
    """Feed-forward torque is `delay` late; the PD law is not. 10 ms on the Go1 (original)."""

    name: ClassVar[str] = "feedforward_delay"
    site: ClassVar[Site] = "command"

    delay: Values = parameter(unit="s", null=0.0, low=0.0, high=0.15, per_joint=True)
    dt_s: float = period(PHYSICS_DT)
    """Period of the commands."""

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> History:
        """An empty line."""
        del batch, rng
        return ()

    def apply(self, signal: JointCommand, time_s: float, state: History) -> tuple[JointCommand, History]:
        """Delays the torque alone."""
        del time_s
        (torque,), line = delayed((signal.torque,), state, self.delay, self.dt_s)
        return replace(signal, torque=torque), line
