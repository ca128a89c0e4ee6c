"""The feed-forward torque takes force later than the rest of its packet."""

from dataclasses import dataclass, replace

from saltus.arrays import Array, namespace
from saltus.effects.delay_line import LateCommand
from saltus.joint_command import JointCommand


@dataclass(frozen=True, kw_only=True)
class FeedforwardDelay(LateCommand, name="feedforward_delay"):
    """Feed-forward torque is `delay` late; the PD law is not. 10 ms (original)."""

    def first(self, signal: JointCommand) -> Array:
        """The last torques, newest first, shape (..., length, 1, 12): a drive has none before its first packet."""
        return self._line.filled(namespace(signal.torque).zeros_like(signal.torque)[..., None, :])

    def apply(self, signal: JointCommand, time_s: Array, state: Array) -> tuple[JointCommand, Array]:
        """Delays the torque alone."""
        del time_s
        late, line = self._line.pushed(signal.torque[..., None, :], self.first(signal) if state is None else state)
        return replace(signal, torque=late[..., 0, :]), line
