"""A robot that does not follow its command is led the other way for a moment."""

import numpy as np

from saltus.arrays import Floats
from saltus.policy.joints.description import LEAST_COMMAND
from saltus.policy.joints.observation import in_command_frame
from saltus.rotations import rotation_matrix
from saltus.wire.messages import RobotState

MEMORY_S, STUCK_SHARE = 0.6, 0.2
"""Memory of the mean share of its command that a robot follows [s], and the share at which it is
stuck: 1 s after it stopped. Some policies stand still before a step, or with a foot caught behind
it, and go on so: they see the same for good (docs/history.md, "Robots that stop before a step")."""
BACK_NS, BACK_SPEED = 1_000_000_000, 0.3
"""For so long it is led the other way, so fast at most [m/s, rad/s]; then it comes by other steps
to what stopped it."""
LONGEST_NS = 100_000_000
"""After states that are farther apart, or a time in which it was not led, all begins anew."""
SAME_WAY = 0.5
"""Least cosine between a command and the one with which it was begun to watch; with one that leads
elsewhere all begins anew."""


class StuckWatch:
    """Watches how a robot follows its command, while a policy moves it."""

    def __init__(self) -> None:
        self._last_ns = -LONGEST_NS
        self._first = np.zeros(3)
        self._back_until_ns = 0
        self._share = 1.0

    def lead(self, state: RobotState, command: Floats) -> Floats:
        """The velocity that a policy is asked for: that of the command, or the other way.

        States come in order. A command is one that the policy can follow, ahead, to the left [m/s]
        and of turning [rad/s], in the frame of the base turned level. What is watched is the way,
        or the turning of a robot that turns on the spot; below `LEAST_COMMAND`, nothing.
        """
        is_way = bool(np.linalg.norm(command[:2]) > LEAST_COMMAND)
        told = np.where([is_way, is_way, not is_way], command, 0.0)
        passed_ns, speed = state.time_ns - self._last_ns, float(np.linalg.norm(told))
        goes_on = told @ self._first > SAME_WAY * speed * np.linalg.norm(self._first)
        self._last_ns = state.time_ns
        if passed_ns > LONGEST_NS or speed <= LEAST_COMMAND or not goes_on:
            self._first, self._share, self._back_until_ns = told, 1.0, 0
            return command
        if state.time_ns < self._back_until_ns:
            return np.asarray(-told * min(1.0, BACK_SPEED / speed))
        follows = float(np.clip(_motion(state) @ told / speed**2, 0.0, 1.0))
        self._share += (follows - self._share) * 1e-9 * passed_ns / MEMORY_S
        if self._share < STUCK_SHARE:
            self._share, self._back_until_ns = 1.0, state.time_ns + BACK_NS
        return command


def _motion(state: RobotState) -> Floats:
    """Velocity ahead and to the left [m/s] and of turning [rad/s], as commands say it."""
    rotation = rotation_matrix(state.quaternion_base_in_world)
    ahead, left, _ = in_command_frame(state.velocity_base_in_world, rotation)
    return np.array([ahead, left, state.angular_velocity_base[2]])
