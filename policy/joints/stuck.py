"""A robot that does not follow its command is led the other way for a moment."""

import numpy as np

from saltus.arrays import Floats
from saltus.policy.joints.description import LEAST_COMMAND
from saltus.rotations import rotation_matrix
from saltus.wire.messages import RobotState

STUCK_NS, STUCK_SHARE = 1_000_000_000, 0.15
"""Time in which a robot that is stuck follows its command by less than this share. Some policies
stand still before a step, or with a foot caught behind it, and go on so: they see the same for
good (docs/history.md, "Robots that stop before a step")."""
BACK_NS, BACK_SPEED = 1_000_000_000, 0.3
"""For so long it is led the other way, so fast at most [m/s, rad/s]; then it comes by other steps
to what stopped it."""


class StuckWatch:
    """Watches how a robot follows its command, while a policy moves it."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._back_until_ns = 0

    def lead(self, state: RobotState, command: Floats) -> Floats:
        """The velocity that a policy is asked for: that of the command, or the other way.

        States come in order. A command is one that the policy can follow, ahead, to the left [m/s]
        and of turning [rad/s]; below `LEAST_COMMAND` nothing is watched.
        """
        speed = float(np.linalg.norm(command))
        if self._last_ns is None or speed <= LEAST_COMMAND:
            self._begin(state.time_ns)
            self._back_until_ns = 0
            return command
        if state.time_ns < self._back_until_ns:
            self._begin(state.time_ns)
            return np.asarray(-command * min(1.0, BACK_SPEED / speed))
        passed_s = 1e-9 * (state.time_ns - self._last_ns)
        self._last_ns = state.time_ns
        linear = state.velocity_base_in_world @ rotation_matrix(state.quaternion_base_in_world)
        moved = np.array([*linear[:2], state.angular_velocity_base[2]])
        self._followed += passed_s * float(moved @ command)
        self._asked += passed_s * float(command @ command)
        if state.time_ns - self._since_ns >= STUCK_NS:
            if self._followed < STUCK_SHARE * self._asked:
                self._back_until_ns = state.time_ns + BACK_NS
            self._begin(state.time_ns)
        return command

    def _begin(self, time_ns: int) -> None:
        self._since_ns = self._last_ns = time_ns
        self._followed = self._asked = 0.0
