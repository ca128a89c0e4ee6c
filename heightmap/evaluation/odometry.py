"""The robot's own odometry: its estimated velocity integrated, and its orientation by the IMU."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from saltus import rotations
from saltus.arrays import Floats
from saltus.wire.messages import RobotState

# A longer silence tells nothing about the way: the original pauses its filter for no longer
MAX_STEP_S = 0.25


@dataclass(frozen=True, kw_only=True, eq=False)
class OdometryPose:
    """Pose of the base in the odometry's world: where the first state was is x = y = z = 0."""

    time_ns: int
    position: Floats
    """[m], shape (3,)."""
    quaternion: Floats
    """(w, x, y, z), base to world, shape (4,)."""

    @property
    def yaw(self) -> float:
        """Heading [rad]."""
        return float(rotations.roll_pitch_yaw(rotations.rotation_matrix(self.quaternion))[2])


class VelocityOdometry:
    """Adds up the velocity that the robot estimates (trapezoidal rule)
    and remembers poses for `memory_s`.
    """

    def __init__(self, memory_s: float) -> None:
        self._memory_ns = round(1e9 * memory_s)
        self._poses: deque[OdometryPose] = deque()
        self._velocity: Floats = np.zeros(3)

    @property
    def pose(self) -> OdometryPose:
        """The newest one."""
        return self._poses[-1]

    def advance(self, state: RobotState) -> bool:
        """Takes the next state; False where the silence before it was so long
        that the way starts anew.
        """
        velocity = np.asarray(state.velocity_base_in_world, np.float64)
        position = np.zeros(3)
        continued = True
        if self._poses:
            elapsed_s = (state.time_ns - self.pose.time_ns) * 1e-9
            continued = 0.0 < elapsed_s <= MAX_STEP_S
            if continued:
                position = self.pose.position + 0.5 * elapsed_s * (self._velocity + velocity)
            else:
                self._poses.clear()
        quaternion = np.asarray(state.quaternion_base_in_world, np.float64)
        self._poses.append(
            OdometryPose(time_ns=state.time_ns, position=position, quaternion=quaternion)
        )
        self._velocity = velocity
        while state.time_ns - self._poses[0].time_ns > self._memory_ns:
            self._poses.popleft()
        return continued

    def pose_at(self, time_ns: int) -> OdometryPose | None:
        """The pose between two states; None before the first that is remembered,
        the newest after the last.
        """
        if not self._poses or time_ns < self._poses[0].time_ns:
            return None
        after = self.pose
        for before in reversed(self._poses):
            if before.time_ns <= time_ns:
                return _between(before, after, time_ns)
            after = before
        return None


def _between(before: OdometryPose, after: OdometryPose, time_ns: int) -> OdometryPose:
    span = after.time_ns - before.time_ns
    share = min((time_ns - before.time_ns) / span, 1.0) if span > 0 else 0.0
    # Two states are 10 ms apart: the chord of two quaternions is as good as the arc.
    sign = 1.0 if float(before.quaternion @ after.quaternion) >= 0.0 else -1.0
    quaternion = (1.0 - share) * before.quaternion + share * sign * after.quaternion
    position = (1.0 - share) * before.position + share * after.position
    return OdometryPose(
        time_ns=time_ns, position=position, quaternion=quaternion / np.linalg.norm(quaternion)
    )
