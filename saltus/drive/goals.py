"""Goals on the ground, one after the other, by what the robot knows of its way."""

import math
from collections.abc import Sequence

import numpy as np

from saltus.arrays import Floats
from saltus.drive.wish import STAND, Wish
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.wire.messages import CommandMode, RobotState

REACHED_M = 0.15
"""Distance at which a goal is reached: about a third of a Go1's trunk."""
TURN_GAIN = 1.5
"""Turning by error of the heading [1/s]: it is gone after 0.7 s, two strides."""
ON_THE_SPOT_RAD = math.radians(60.0)
"""Beyond this error of the heading it turns on the spot."""
SLOWING = 1.0
"""Speed by distance from the last goal [1/s]: it arrives slowly."""
SLOWEST_MPS = 0.3
TURN_RPS = 0.8
"""Fastest turning where none is given: well within what policies are trained for."""


class Goals:
    """Leads a robot over goals; then it stands.

    Args:
        goals: Places in the frame of the robot when it is first seen, ahead and to the left [m].
        speed_mps: Between them.
        turn_rps: At most.
    """

    def __init__(
        self, goals: Sequence[tuple[float, float]], speed_mps: float, turn_rps: float
    ) -> None:
        self._left = [np.array(goal, np.float64) for goal in goals]
        self._speed, self._turn = speed_mps, turn_rps
        self._way = PoseOnWay()

    @property
    def is_over(self) -> bool:
        """True where all goals have been reached."""
        return not self._left

    @property
    def left(self) -> int:
        """Number of goals that are still to be reached."""
        return len(self._left)

    def wish(self, state: RobotState) -> Wish:
        """The wish at a state; states come in order, none twice."""
        return self.lead(*self._way.step(state))

    def lead(self, place: Floats, heading: float) -> Wish:
        """The wish of a robot at a place [m], shape (2,), in the frame of the goals."""
        while self._left and math.hypot(*(self._left[0] - place)) < REACHED_M:
            del self._left[0]
        if not self._left:
            return STAND
        ahead, left = self._left[0] - place
        error = math.remainder(math.atan2(left, ahead) - heading, 2.0 * math.pi)
        speed = self._speed
        if len(self._left) == 1:
            speed = min(speed, max(SLOWEST_MPS, SLOWING * math.hypot(ahead, left)))
        turns = abs(error) > ON_THE_SPOT_RAD
        return Wish(
            mode=CommandMode.WALK,
            ahead_mps=0.0 if turns else speed * math.cos(error),
            turn_rps=min(max(TURN_GAIN * error, -self._turn), self._turn),
        )


class PoseOnWay:
    """Place and heading in the frame of the first state:
    by odometry, else by adding up velocities.
    """

    def __init__(self) -> None:
        self._first: tuple[Floats, float] | None = None
        self._walked = np.zeros(2)
        self._last_ns = 0

    def step(self, state: RobotState) -> tuple[Floats, float]:
        """Place [m], shape (2,), and heading [rad] at a state."""
        _, _, yaw = roll_pitch_yaw(rotation_matrix(state.quaternion_base_in_world))
        if state.position_base_in_odometry.size:
            here = np.array(state.position_base_in_odometry[:2])
        else:
            passed_s = 1e-9 * (state.time_ns - self._last_ns) if self._first is not None else 0.0
            self._walked = self._walked + passed_s * state.velocity_base_in_world[:2]
            here = self._walked
        self._last_ns = state.time_ns
        if self._first is None:
            self._first = here, float(yaw)
        start, first_yaw = self._first
        cosine, sine = math.cos(first_yaw), math.sin(first_yaw)
        x, y = here - start
        return np.array([cosine * x + sine * y, cosine * y - sine * x]), float(yaw) - first_yaw
