"""How long a log shows what a kind of sensor is judged by, within its segments.

A fit always finds something. What is named must hold on a part of the log that no fit has seen.
That part, and the parts between which fits are compared, need some seconds each.
"""

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.log import rows_between, segments_of
from saltus.real2sim.problem.problem import Segment
from saltus.recordings.run_log import RunLog

STEP_S = 0.1
"""Over which a joint moves or rests: angles of a noise of 1 mrad then tell 0.05 rad/s."""
LEAST_RAD = 0.005
"""In a step, at least: below 0.05 rad/s a joint stands still (`excitation.LEAST_SPEED`)."""
SETTLING_S = 0.5
"""After a motion a joint settles, which tells as much: two periods of a leg under PD control."""


def moving_s(log: RunLog) -> float:
    """Seconds in segments in which a joint moves, or has just moved."""
    between, time_s = rows_between(log.joints.time_s), log.joints.time_s
    total = 0.0
    for segment in segments_of(log):
        rows = between(segment.start_s, np.nextafter(segment.end_s, np.inf))
        total += _moving_s(time_s[rows], log.joints.q[rows])
    return total


def _moving_s(time_s: Floats, q: Floats) -> float:
    """Seconds of one segment, by steps of `STEP_S`."""
    if len(time_s) < 2:
        return 0.0
    step = ((time_s - time_s[0]) / STEP_S).astype(np.int64)
    starts = np.flatnonzero(np.diff(step, prepend=-1))
    reach = np.maximum.reduceat(q, starts) - np.minimum.reduceat(q, starts)
    moves_s = time_s[starts][(reach > LEAST_RAD).any(axis=1)]
    edges = np.append(time_s[starts], time_s[-1])
    since = edges[:-1] - np.concatenate([[-np.inf], moves_s])[np.searchsorted(moves_s, edges[:-1], side="right")]
    return float(np.diff(edges)[since <= SETTLING_S].sum())


def standing_s(log: RunLog) -> float:
    """Seconds in segments in which the base's pose is measured; standing shows a weight, too."""
    return _covered_s(segments_of(log), None if log.base is None else log.base.time_s)


def turning_s(log: RunLog) -> float:
    """Seconds in segments that the IMU covers."""
    return _covered_s(segments_of(log), None if log.imu is None else log.imu.time_s)


def seeing_s(log: RunLog) -> float:
    """Seconds in segments in which images arrive."""
    return _covered_s(segments_of(log), None if log.depth is None else log.depth.arrival_s)


def _covered_s(segments: tuple[Segment, ...], time_s: Floats | None) -> float:
    if time_s is None or not len(time_s):
        return 0.0
    first, last = float(time_s[0]), float(time_s[-1])
    return sum(max(0.0, min(s.end_s, last) - max(s.start_s, first)) for s in segments)
