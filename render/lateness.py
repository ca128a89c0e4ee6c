"""Lateness of images beyond what their times say, from the motion of a robot over level ground.

A trunk that pitches turns the ground in the camera's images. Where their times are right, points of
level ground lie level with the attitude of that time; where an image is older than its time says,
they do with the attitude of before.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.errors import RecordingError
from saltus.render.calibrate import BLOCKS, CameraPlace, SeenPoints, in_range, interval_90
from saltus.robots.robot import Robot
from saltus.rotations import rotation_matrix
from saltus.wire.messages import DepthFrame, RobotState

LEAST_TURN = 0.15
"""Rate at which the trunk of a robot pitches or rolls in the images that count [rad/s]: 30 ms then
are the quarter of a degree that an IMU is off."""
FEWEST, MOST = 24, 160
"""Images that count; more add little."""
EARLIEST_S, LATEST_S, STEP_S = -0.06, 0.2, 0.002
"""Lateness is sought between these: a Go2's cameras are 80 to 142 ms late (users' measurements)."""
FEWEST_POINTS = 100  # of an image
FAR_M = 0.05
"""Points farther than this off level count as this: edges, and what is no ground."""


@dataclass(frozen=True, kw_only=True)
class Lateness:
    """How late a camera's images are against the times that they state."""

    late_s: float
    """How much earlier than its time an image was taken [s]."""
    half_width_90: float
    """Half of the 90 % interval, from the scatter of the recording's parts [s]."""
    frames: int
    """Images that counted."""


def measure_lateness(
    frames: Sequence[DepthFrame], states: Sequence[RobotState], robot: Robot, place: CameraPlace
) -> Lateness:
    """Lateness by images and states of one robot that moves on level ground.

    Args:
        frames: Images.
        states: States of the same time, at 100 Hz.
        robot: The robot, with its camera as it is claimed.
        place: Pitch, roll and height of the camera, as `calibrate` finds them.

    Raises:
        RecordingError: the robot hardly turns in the images, or they do not show the ground.
    """
    times = np.array([state.time_ns for state in states], dtype=np.int64)
    turning = [
        frame for frame in frames
        if len(times) and times[0] < frame.time_ns - 1e9 * LATEST_S
        and frame.time_ns - 1e9 * EARLIEST_S < times[-1]
        and _turn(states[int(np.searchsorted(times, frame.time_ns))]) > LEAST_TURN
    ]  # fmt: skip
    chosen = np.unique(np.linspace(0, max(len(turning) - 1, 0), MOST).round()).astype(int)
    ups = np.array(
        [rotation_matrix(np.asarray(state.quaternion_base_in_world))[2] for state in states]
    )
    tried = np.arange(EARLIEST_S, LATEST_S + 0.5 * STEP_S, STEP_S)
    off = []
    for frame in [turning[i] for i in chosen] if turning else []:
        view = SeenPoints.of(frame, states[int(np.searchsorted(times, frame.time_ns))], robot)
        points = view.in_base(place)[in_range(view.expected(place)[0])]
        if len(points) >= FEWEST_POINTS:
            at_s = 1e-9 * (frame.time_ns - times[0]) - tried
            off.append(_off_level(points, _between(1e-9 * (times - times[0]), ups, at_s)))
    if len(off) < FEWEST:
        raise RecordingError(
            f"{len(off)} images of level ground in which the trunk turns: {FEWEST} are needed, so "
            "let the robot pitch, or bound, over level ground with nothing ahead"
        )
    costs = np.array(off)
    parts = [_least(tried, costs[block]) for block in np.array_split(np.arange(len(off)), BLOCKS)]
    return Lateness(
        late_s=_least(tried, costs),
        half_width_90=float(interval_90(np.array(parts))),
        frames=len(off),
    )


def _turn(state: RobotState) -> float:
    """Rate of pitch and roll [rad/s]."""
    return float(np.hypot(*state.angular_velocity_base[:2]))


def _between(times_s: Floats, ups: Floats, at_s: Floats) -> Floats:
    """Upward directions in the base frame at some times, shape (len(at_s), 3)."""
    return np.stack([np.interp(at_s, times_s, ups[:, axis]) for axis in range(3)], axis=-1)


def _off_level(points: Floats, ups: Floats) -> Floats:
    """Mean distance of points from the level of their median [m], for each upward direction.

    Shape (len(ups),).
    """
    heights = ups @ points.T
    off = np.abs(heights - np.median(heights, axis=1, keepdims=True))
    return np.minimum(off, FAR_M).mean(axis=1)


def _least(tried: Floats, costs: Floats) -> float:
    """The value whose sum of costs, shape (n, len(tried)), is least; between two by a parabola."""
    cost = costs.sum(axis=0)
    place = int(np.clip(np.argmin(cost), 1, len(cost) - 2))
    before, here, after = cost[place - 1 : place + 2]
    bend = max(float(before - 2.0 * here + after), 1e-12)
    return float(tried[place] + STEP_S * np.clip(0.5 * (before - after) / bend, -1.0, 1.0))
