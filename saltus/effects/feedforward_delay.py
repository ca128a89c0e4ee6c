"""The feed-forward torque takes force later than the rest of its packet."""

from dataclasses import dataclass, replace

from saltus.effects.delay_line import History, LateCommand, delayed
from saltus.wire.messages import JointCommand


@dataclass(frozen=True, kw_only=True)
class FeedforwardDelay(LateCommand, name="feedforward_delay"):
    """Feed-forward torque is `delay` late; the PD law is not. 10 ms (original)."""

    def apply(self, signal: JointCommand, time_s: float, state: History) -> tuple[JointCommand, History]:
        """Delays the torque alone."""
        del time_s
        (torque,), line = delayed((signal.torque,), state, self.delay, self.dt_s)
        return replace(signal, torque=torque), line
