"""A log of a robot on the ground, cut into short windows
from whose measured state a simulation can start.

A simulation that runs for long goes its own way at the first footfall. Windows of half a second
keep it close, and under PD control what is wrong in the state at their start fades.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import savgol_filter

from saltus.arrays import Floats, Indices
from saltus.constants import PHYSICS_DT, POLICY_STEPS
from saltus.errors import RecordingError
from saltus.real2sim.problem import quaternions
from saltus.real2sim.problem.log import claimed_gains, commanded_torque, interpolate_columns
from saltus.real2sim.problem.problem import LogSegment
from saltus.recordings.run_log import RunLog

BLOCK_STEPS = 2 * POLICY_STEPS
"""Residuals are means over 20 ms: the body answers no faster, and sensors average out."""
BLOCKS = 30
"""Blocks of a window: 0.6 s, some periods of the slowest mode of a body on its legs."""
WINDOW_STEPS = BLOCKS * BLOCK_STEPS
HISTORY_STEPS = 26
"""Steps before a window of which commands are kept: a command may be 50 ms late."""
SMOOTHING_STEPS = 25
"""States at the start of windows come from parabolas through 50 ms: bodies move below 10 Hz; noise
falls to a third."""
LATEST_STEPS, LATE_SHARE = 26, 0.6
"""A gyroscope is late if some of these steps later it differs by this share, or less, from how the
base turns."""
SEARCH_STEPS = 30
"""A window may start this much later, where the motion is smooth."""
BUDGET_S = 10.8
"""Time that is simulated for one set of unknowns: beyond that, windows are spread over the log with
gaps."""

POSE, JOINTS, VELOCITY, RATES = slice(0, 7), slice(7, 19), slice(19, 22), slice(22, 34)
"""Columns of a state: base position and quaternion, joints, base velocity in the world, joint
velocities."""
BY_WINDOW = ("start_s", "segment", "qpos", "qvel", "drive", "measured")
"""Fields of `BodyWindows` that have a value for each."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyWindows:
    """Windows of a log of a robot on the ground: where simulations start and what was measured
    after that; w windows.

    Attributes:
        start_s: Shape (w,).
        segment: Index of the segment of each, shape (w,).
        qpos: State at the start, shape (w, 19).
        qvel: Shape (w, 18).
        drive: Commands to the drives: kp q_des + kd dq_des + tau_ff for each physics step,
            `HISTORY_STEPS` before the start included [Nm], shape (w, HISTORY_STEPS + WINDOW_STEPS,
            12).
        measured: Means over blocks, columns as `POSE`, `JOINTS`, `VELOCITY`, `RATES`, shape (w,
            BLOCKS, 34).
        kp: Shape (12,).
        kd: Shape (12,).
    """

    start_s: Floats
    segment: Indices
    qpos: Floats
    qvel: Floats
    drive: Floats
    measured: Floats
    kp: Floats
    kd: Floats

    def taken(self, part: slice) -> "BodyWindows":
        """Some of the windows."""
        return replace(self, **{name: getattr(self, name)[part] for name in BY_WINDOW})

    @property
    def block_s(self) -> Floats:
        """Middle of each block, shape (w, BLOCKS)."""
        middle = (np.arange(BLOCKS) + 0.5) * BLOCK_STEPS * PHYSICS_DT
        return np.asarray(self.start_s[:, None] + middle)


@dataclass(frozen=True, kw_only=True, eq=False)
class SegmentTrack:
    """The signals of one segment at every physics step; n steps."""

    time_s: Floats
    states: Floats
    """Shape (n, 34), columns as `POSE`, `JOINTS`, `VELOCITY`, `RATES`."""
    gyro: Floats | None
    """[rad/s], shape (n, 3)."""


def body_windows(log: RunLog, segments: Sequence[LogSegment]) -> BodyWindows:
    """Cuts a log with a measured base; `RecordingError` where no segment of it is long enough."""
    kp, kd = claimed_gains(log)
    drive = commanded_torque(log)
    starts = _starts(segments)
    tracks = {
        i: on_time(segment_track(log, segments[i])) for i in {segment for segment, _ in starts}
    }
    parts = []
    for segment, start in starts:
        now = tracks[segment]
        k = _smooth_place(now, start)
        if k + WINDOW_STEPS > len(now.time_s):
            continue
        qpos, qvel = _state(now, k)
        times = now.time_s[k] + PHYSICS_DT * np.arange(-HISTORY_STEPS, WINDOW_STEPS)
        row = np.searchsorted(log.joints.time_s, times + 0.05 * PHYSICS_DT, side="right") - 1
        blocks = now.states[k : k + WINDOW_STEPS].reshape(BLOCKS, BLOCK_STEPS, -1).mean(axis=1)
        parts.append((now.time_s[k], segment, qpos, qvel, drive[np.maximum(row, 0)], blocks))
    if not parts:
        raise RecordingError("no segment of the log is as long as a window of 0.65 s")
    columns = [np.array(column) for column in zip(*parts, strict=True)]
    return BodyWindows(**dict(zip(BY_WINDOW, columns, strict=True)), kp=kp, kd=kd)


def segment_track(log: RunLog, segment: LogSegment) -> SegmentTrack:
    """Signals of a segment at every physics step; slower streams are interpolated."""
    joints, base = log.joints, log.base
    if base is None:
        raise ValueError("the log has no base.csv")
    rows = joints.time_s[
        (joints.time_s >= segment.start_s - 1e-6) & (joints.time_s <= segment.end_s + 1e-6)
    ]
    time_s = np.arange(rows[0], rows[-1] + 0.5 * PHYSICS_DT, PHYSICS_DT)
    position = interpolate_columns(time_s, base.time_s, base.values[:, :3])
    turn = quaternions.normalise_quaternions(
        interpolate_columns(
            time_s, base.time_s, quaternions.continuous_quaternions(base.values[:, 3:7])
        )
    )
    q = interpolate_columns(time_s, joints.time_s, joints.q)
    dq = (
        np.gradient(q, PHYSICS_DT, axis=0)
        if joints.dq is None
        else interpolate_columns(time_s, joints.time_s, joints.dq)
    )
    velocity = interpolate_columns(time_s, base.time_s, base.values[:, 7:10])
    gyro = (
        None
        if log.imu is None
        else interpolate_columns(time_s, log.imu.time_s, log.imu.values[:, 4:7])
    )
    return SegmentTrack(
        time_s=time_s, states=np.concatenate([position, turn, q, velocity, dq], axis=1), gyro=gyro
    )


def late_steps(now: SegmentTrack, turning: Floats) -> int:
    """Steps by which a gyroscope is later than how the base turns [rad/s], shape (n, 3); 0 where it
    is on time or there is none.
    """
    if now.gyro is None:
        return 0
    apart = [
        np.var(now.gyro[k:] - turning[: len(turning) - k], axis=0).sum()
        for k in range(min(LATEST_STEPS, len(turning) - 1))
    ]
    return int(np.argmin(apart)) if min(apart) < LATE_SHARE * apart[0] else 0


def on_time(now: SegmentTrack) -> SegmentTrack:
    """A track whose readings of a late gyroscope stand at the time at which they were measured.

    At its end the last reading stands for those that had not come yet. How late the gyroscope is,
    the IMU's own problem finds.
    """
    late = late_steps(now, angular_velocity(now.states[:, 3:7]))
    if now.gyro is None or not late:
        return now
    gyro = np.concatenate([now.gyro[late:], np.repeat(now.gyro[-1:], late, axis=0)])
    return replace(now, gyro=gyro)


def angular_velocity(quaternion: Floats) -> Floats:
    """Smooth rates of a base, from its orientation at every physics step [rad/s],
    base frame, shape (n, 3).
    """
    window = min(SMOOTHING_STEPS, len(quaternion) - (len(quaternion) + 1) % 2)
    rate = savgol_filter(quaternion, window, 2, deriv=1, delta=PHYSICS_DT, axis=0)
    w, v = quaternion[:, :1], quaternion[:, 1:]
    dw, dv = rate[:, :1], rate[:, 1:]
    return np.asarray(2.0 * (w * dv - dw * v - np.cross(v, dv)))


def _starts(segments: Sequence[LogSegment]) -> list[tuple[int, float]]:
    """Segment and earliest start [s] of each window: end to end,
    or spread where the log is longer than the budget.
    """
    length = WINDOW_STEPS * PHYSICS_DT
    # States at the very edge of a stretch would be noisier by half
    edge = 0.5 * SMOOTHING_STEPS * PHYSICS_DT
    room = [max(0.0, s.end_s - s.start_s - edge) for s in segments]
    share = min(1.0, BUDGET_S / max(sum(room), 1e-9))
    starts, owed = [], 0.0
    for i, segment in enumerate(segments):
        owed += share * room[i] / length
        count = min(int((room[i] + 1e-6) / length), max(1, round(owed)))
        owed -= count
        spare = (room[i] - count * length) / count if count else 0.0
        starts += [(i, segment.start_s + edge + k * (length + spare)) for k in range(count)]
    return starts


def _smooth_place(now: SegmentTrack, start_s: float) -> int:
    """The step near `start_s` at which the joints' velocities are closest to a parabola."""
    first = int(np.searchsorted(now.time_s, start_s - 0.5 * PHYSICS_DT))
    last = min(first + SEARCH_STEPS, len(now.time_s) - WINDOW_STEPS)
    if last <= first:
        return first
    low, high = max(0, first - SMOOTHING_STEPS), min(len(now.time_s), last + SMOOTHING_STEPS)
    rates = now.states[low:high, RATES]
    rough = np.sum((rates - savgol_filter(rates, SMOOTHING_STEPS, 2, axis=0)) ** 2, axis=1)
    around = np.convolve(rough, np.ones(SMOOTHING_STEPS), mode="same")
    return int(first + np.argmin(around[first - low : last - low]))


def _state(now: SegmentTrack, k: int) -> tuple[Floats, Floats]:
    """Smoothed state at step `k`: `qpos` and `qvel` of the simulation."""
    low = max(0, min(k - SMOOTHING_STEPS // 2, len(now.time_s) - SMOOTHING_STEPS))
    part = slice(low, low + SMOOTHING_STEPS)
    smooth = savgol_filter(now.states[part], SMOOTHING_STEPS, 2, axis=0)[k - low]
    smooth[3:7] /= np.linalg.norm(smooth[3:7])
    if now.gyro is None:
        rate = angular_velocity(now.states[part, 3:7])[k - low]
    else:  # less noise than the change of the orientation, but for a bias
        bias = np.mean(now.gyro - angular_velocity(now.states[:, 3:7]), axis=0)
        rate = savgol_filter(now.gyro[part], SMOOTHING_STEPS, 2, axis=0)[k - low] - bias
    return smooth[:19], np.concatenate([smooth[VELOCITY], rate, smooth[RATES]])
