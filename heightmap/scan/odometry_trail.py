"""Places where a robot's odometry has it, over the last second:
velocities added up, or the positions that somebody tells.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from saltus.arrays import Floats
from saltus.heightmap.scan.elevation import OdometryPoses
from saltus.rotations import quaternion_from_vector, rotation_matrix
from saltus.wire.messages import RobotState

KEPT_NS = 1_000_000_000
"""Images are up to 0.2 s old (`FlightSettings.latency_s`)."""
GAP_NS = 500_000_000
"""After a longer silence the robot may be anywhere."""
REACH_NS = 60_000_000
"""So far beyond the states that are known a pose is believed, by velocity and rate of turn."""
JUMP_M, JUMP_S = 0.1, 0.1
"""A position that moves by more than this in a step, and than the velocity brings in `JUMP_S`, has
jumped: the odometry was set anew, not the robot. At 3 m/s positions of 10 Hz, each told ten times,
move by 0.3 m."""
JUMP_RAD = 0.35
"""An attitude that turns by more in a step than the gyroscope says has jumped: 20 degrees."""


class TrailPose(NamedTuple):
    """Place and attitude of a robot by its odometry, at one of its states."""

    time_ns: int
    position: Floats
    """In the odometry's world, without its jumps [m], shape (3,)."""
    rotation: Floats
    """Base to world, shape (3, 3)."""
    velocity: Floats
    """[m/s], shape (3,)."""
    turn: Floats
    """Rate of turn in the base frame [rad/s], shape (3,)."""
    joint_position: Floats
    """[rad], shape (12,)."""

    def moved(self, seconds: float) -> "TrailPose":
        """Where the robot is so much later, or earlier, if it keeps its velocities."""
        angle = self.turn * seconds
        return self._replace(
            position=self.position + self.velocity * seconds,
            rotation=self.rotation @ rotation_matrix(quaternion_from_vector(angle)),
        )

    @property
    def pose(self) -> OdometryPoses:
        """Pose as the map takes it: single precision, a batch of one robot."""
        return OdometryPoses(
            self.position[None].astype(np.float32), self.rotation[None].astype(np.float32)
        )


class OdometryTrail:
    """The robot's poses of the last second by its odometry, so that late images are put where they
    were taken.
    """

    def __init__(self) -> None:
        self._points: deque[TrailPose] = deque()
        self._told: Floats | None = None
        self._offset = np.zeros(3)
        """Sum of the jumps of the positions that were told."""

    def add(self, state: RobotState, missing: Floats | None = None) -> bool:
        """Goes on to a state.

        True where nothing that is known from before can be placed any more.

        Args:
            state: Of the robot.
            missing: Velocity that it leaves out [m/s], shape (3,); None: nothing. Positions that
                it tells do not.
        """
        rotation = rotation_matrix(np.asarray(state.quaternion_base_in_world, np.float64))
        last = self._points[-1] if self._points else None
        lost = last is None or not 0 < state.time_ns - last.time_ns < GAP_NS
        seconds = 0.0 if last is None or lost else 1e-9 * (state.time_ns - last.time_ns)
        if last is not None and not lost:
            lost = _angle(last.moved(seconds).rotation.T @ rotation) > JUMP_RAD
        if last is None or lost:
            self._points.clear()
            self._told, self._offset = None, np.zeros(3)
        velocity = np.asarray(state.velocity_base_in_world, np.float64)
        if missing is not None and not np.size(state.position_base_in_odometry):
            velocity = velocity + missing
        position = self._position(state, None if lost else last, velocity, seconds)
        turn = np.asarray(state.angular_velocity_base, np.float64)
        self._points.append(
            TrailPose(state.time_ns, position, rotation, velocity, turn, state.joint_position)
        )
        while state.time_ns - self._points[0].time_ns > KEPT_NS:
            self._points.popleft()
        return last is not None and lost

    def _position(
        self, state: RobotState, last: TrailPose | None, velocity: Floats, seconds: float
    ) -> Floats:
        told = np.asarray(state.position_base_in_odometry, np.float64)
        begin = np.array([0.0, 0.0, state.base_height]) if last is None else last.position
        way = np.zeros(3) if last is None else 0.5 * seconds * (velocity + last.velocity)
        if not told.size:
            self._told = None
            return begin + way
        if last is None:
            self._offset = np.zeros(3)
        elif self._told is None:
            self._offset = begin + way - told
        else:
            allowed = JUMP_M + JUMP_S * max(np.linalg.norm(velocity), np.linalg.norm(last.velocity))
            if np.linalg.norm(told - self._told) > allowed:
                self._offset = self._offset + way - (told - self._told)
        self._told = told
        return told + self._offset

    @property
    def now(self) -> TrailPose:
        """The newest."""
        return self._points[-1]

    def at(self, time_ns: int) -> TrailPose | None:
        """The robot at a time; None where that is too far from all that is known."""
        points = self._points
        if (
            not points
            or time_ns - points[-1].time_ns > REACH_NS
            or points[0].time_ns - time_ns > REACH_NS
        ):
            return None
        after = None
        for before in reversed(points):
            if before.time_ns <= time_ns:
                break
            after = before
        early = before.moved(1e-9 * (time_ns - before.time_ns))
        if after is None or after is before:
            return early
        share = (time_ns - before.time_ns) / (after.time_ns - before.time_ns)
        position = before.position + share * (after.position - before.position)
        return early._replace(position=position)


def _angle(rotation: Floats) -> float:
    """By how much a rotation turns [rad]."""
    return math.acos(min(max(0.5 * (float(rotation.trace()) - 1.0), -1.0), 1.0))
