"""Offsets and drifts between the clocks of the streams of a run log, with intervals.

If two streams show the same motion, one of them is fitted to the other by its time alone. Between
two sensors, the offset of their clocks and a latency are the same number; only an event with time
stamps of both clocks could separate them. Columns of one table have one clock, and their offset is
a true delay.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation
from scipy.stats import t as student

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.camera.rays import expected_depth
from saltus.real2sim.problem.log import (
    claimed_gains,
    commanded_torque,
    has_changing_gains,
    why_commands_unknown,
)
from saltus.recordings.run_log import LogTable, RunLog

# Offsets that are tried: some lead, and the largest latency of a camera on a robot
SEARCH_S = (
    -0.05,
    0.2,
)
GRID_S = 0.005
ITERATIONS = 8
SMOOTH_S = 0.02  # to either side; a body turns and heaves at a few hertz
BLOCK_S = 2.0  # blocks whose offsets are compared: longer than a motion is correlated with itself
MIN_BLOCKS = 3
MIN_POWER = 1e-3  # of the best block; blocks at rest say nothing
MIN_CORRELATION = 0.5  # below it the two streams do not show the same motion
DEPTH_GRID = 8  # rows and columns of an image that are compared
LEAST_DRIFT = (
    1e-5  # smallest drift that is stated: 1 ms in two minutes, less than quartz clocks differ
)
POSES_S = 0.01  # between the poses of predicted images; a body moves more slowly
MIN_VALID = 0.8  # of the images in which a pixel is valid
NEAR_RANGE = 0.9  # of the camera's range
JUMP_M = 0.1  # between poses: 10 m/s along a ray; only an edge is faster


@dataclass(frozen=True, kw_only=True)
class ClockOffset:
    """How much later one stream of a log is than another, by its clock."""

    stream: str
    reference: str
    offset_s: float
    """Positive if the stream is late; at the middle of the log."""
    ci90_s: tuple[float, float]
    drift: float
    """Growth of the offset [s/s]."""
    drift_ci90: tuple[float, float]
    is_relative: bool
    """True where clock offset and latency cannot be separated."""

    @property
    def text(self) -> str:
        """The offset in a sentence."""
        first, last = (1e3 * end for end in self.ci90_s)
        late = (
            f"{self.stream} is {1e3 * self.offset_s:.1f} ms ({first:.1f} to {last:.1f}) "
            f"behind {self.reference}"
        )
        low, high = self.drift_ci90
        drifts = (
            f", drifts by {1e3 * self.drift:.2f} ms per s"
            if (low > 0 or high < 0) and abs(self.drift) > LEAST_DRIFT
            else ""
        )
        return (
            late
            + drifts
            + (" (clock and latency cannot be told apart)" if self.is_relative else "")
        )


def clock_offsets(log: RunLog) -> tuple[ClockOffset, ...]:
    """Offsets of all pairs of streams in a log that show the same motion."""
    found = (
        _torque_on_command(log),
        _gyro_on_base(log),
        _depth_on_base(log, is_capture=False),
        _depth_on_base(log, is_capture=True),
    )
    return tuple(offset for offset in found if offset is not None)


@dataclass(frozen=True, kw_only=True)
class MotionSamples:
    """Samples of one motion as a stream of a log shows it, to compare clocks by."""

    name: str
    time_s: Floats
    """Shape (n,), increasing."""
    values: Floats
    """Shape (n, channels)."""
    held_s: float = 0.0
    """Time for which a value is held, as of commands; offsets are known to within it."""

    def at(self, time_s: Floats) -> Floats:
        """Values at other times, shape (m, channels)."""
        return np.column_stack([np.interp(time_s, self.time_s, column) for column in self.values.T])


def fit_offset(
    stream: MotionSamples, reference: MotionSamples, *, is_relative: bool
) -> ClockOffset | None:
    """Offset of a stream from a reference with the same motion; None if the motions differ.

    Each channel may have its own scale and mean. The interval comes from the disagreement of blocks
    of the log.
    """
    stream, reference = _smooth(stream), _smooth(reference)
    low, high = SEARCH_S
    inside = (stream.time_s > reference.time_s[0] + high) & (
        stream.time_s < reference.time_s[-1] + low
    )
    time_s, values = stream.time_s[inside], stream.values[inside]
    blocks = (
        np.floor((time_s - time_s[0]) / BLOCK_S).astype(int) if len(time_s) else np.zeros(0, int)
    )
    if len(np.unique(blocks)) < MIN_BLOCKS:
        return None
    values = values - values.mean(axis=0)
    offset = max(
        np.arange(low, high, GRID_S), key=lambda d: _explained(reference.at(time_s - d), values)
    )
    for _ in range(ITERATIONS):
        error, slope = _linearise(reference, time_s, values, offset)
        step = float(np.sum(error * slope) / max(np.sum(slope**2), 1e-30))
        offset += float(np.clip(step, -GRID_S, GRID_S))
    if _explained(reference.at(time_s - offset), values) < MIN_CORRELATION**2:
        return None
    error, slope = _linearise(reference, time_s, values, offset)
    trend = _trend(np.sum(slope**2, axis=1), np.sum(error * slope, axis=1), time_s, blocks)
    if trend is None:
        return None
    (mean, half_width), (drift, drift_half_width) = trend
    drift_half_width += reference.held_s / float(time_s[-1] - time_s[0])
    return ClockOffset(
        stream=stream.name,
        reference=reference.name,
        offset_s=float(offset) + mean,
        ci90_s=(
            float(offset) + mean - half_width - reference.held_s,
            float(offset) + mean + half_width,
        ),
        drift=drift,
        drift_ci90=(drift - drift_half_width, drift + drift_half_width),
        is_relative=is_relative,
    )


def _smooth(motion: MotionSamples) -> MotionSamples:
    """A copy of a motion without fast noise.

    A line between noisy samples is less noisy than the samples, which would draw an offset to
    halfway between them.
    """
    half = (
        round(SMOOTH_S / float(np.median(np.diff(motion.time_s)))) if len(motion.time_s) > 1 else 0
    )
    return replace(motion, values=uniform_filter1d(motion.values, 2 * half + 1, axis=0))


def _explained(reference: Floats, values: Floats) -> float:
    """Share of the power of all channels that one scale per channel explains."""
    reference = reference - reference.mean(axis=0)
    scale = np.sum(reference * values, axis=0) / np.maximum(np.sum(reference**2, axis=0), 1e-30)
    return 1 - float(np.sum((values - scale * reference) ** 2) / max(np.sum(values**2), 1e-30))


def _linearise(
    reference: MotionSamples, time_s: Floats, values: Floats, offset: float
) -> tuple[Floats, Floats]:
    """Residual at an offset and its derivative by the offset; shapes (n, channels)."""
    width = 2e-3  # s, of the finite difference: a row of a fast log
    early, now, late = (reference.at(time_s - offset + shift) for shift in (width, 0.0, -width))
    now = now - now.mean(axis=0)
    scale = np.sum(now * values, axis=0) / np.maximum(np.sum(now**2, axis=0), 1e-30)
    slope = scale * (late - early) / (2 * width)
    # changes that scale and mean can make do not count for the offset
    slope = slope - slope.mean(axis=0)
    slope = slope - now * np.sum(slope * now, axis=0) / np.maximum(np.sum(now**2, axis=0), 1e-30)
    return values - scale * now, slope


def _trend(
    power: Floats, product: Floats, time_s: Floats, blocks: NDArray[np.int_]
) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Line through the offsets of blocks, weighted by their power.

    Returns:
        Mean and half of its 90 % interval [s], slope and half of its 90 % interval [s/s].
    """
    count = int(blocks[-1]) + 1
    power = np.bincount(blocks, power, count).astype(np.float64)
    product = np.bincount(blocks, product, count).astype(np.float64)
    middle = np.bincount(blocks, time_s, count) / np.maximum(
        np.bincount(blocks, minlength=count), 1
    )
    significant = power > MIN_POWER * power.max()
    if significant.sum() < MIN_BLOCKS:
        return None
    deviation, weight = (
        product[significant] / power[significant],
        power[significant] / power[significant].sum(),
    )
    since = middle[significant] - np.sum(weight * middle[significant])
    spread = float(np.sum(weight * since**2))
    mean, slope = (
        float(np.sum(weight * deviation)),
        float(np.sum(weight * since * deviation)) / spread,
    )
    left = weight * (deviation - mean - slope * since)
    freedom = len(left) - 2
    # from the scatter itself (sandwich estimate): blocks with much power may also have large errors
    wide = float(student.ppf(0.95, freedom) * np.sqrt(len(left) / freedom))
    return (mean, wide * float(np.sqrt(np.sum(left**2)))), (
        slope,
        wide * float(np.sqrt(np.sum((left * since) ** 2))) / spread,
    )


def _torque_on_command(log: RunLog) -> ClockOffset | None:
    """Torque without the encoder's part shows when a command arrived at the drive."""
    joints = log.joints
    if (
        joints.tau_est is None
        or joints.dq is None
        or why_commands_unknown(log)
        or has_changing_gains(log)
    ):
        return None
    (kp, kd), command = claimed_gains(log), commanded_torque(log)
    moved = np.ptp(command, axis=0) > 0
    if not moved.any():
        return None
    row_s = float(np.median(np.diff(joints.time_s)))
    received = joints.tau_est + kp * joints.q + kd * joints.dq
    reference = MotionSamples(
        name="command", time_s=joints.time_s, values=command[:, moved], held_s=row_s
    )
    stream = MotionSamples(name="tau_est", time_s=joints.time_s, values=received[:, moved])
    return fit_offset(stream, reference, is_relative=False)


def _gyro_on_base(log: RunLog) -> ClockOffset | None:
    """Gyroscope against the rotation of the measured pose."""
    if log.imu is None or log.base is None or len(log.base.time_s) < 3:
        return None
    rotations = Rotation.from_quat(log.base.values[:, 3:7], scalar_first=True)
    steps_s = np.diff(log.base.time_s)[:, None]
    turn = np.asarray((rotations[:-1].inv() * rotations[1:]).as_rotvec() / steps_s, np.float64)
    between = 0.5 * (log.base.time_s[1:] + log.base.time_s[:-1])
    reference = MotionSamples(name="base", time_s=between, values=turn)
    return fit_offset(
        MotionSamples(name="gyro", time_s=log.imu.time_s, values=log.imu.values[:, 4:7]),
        reference,
        is_relative=True,
    )


def _depth_on_base(log: RunLog, *, is_capture: bool) -> ClockOffset | None:
    """Images against those predicted from the measured pose, by arrival or by capture stamps."""
    camera = log.meta.get("camera")
    if log.depth is None or log.base is None or not isinstance(camera, dict):
        return None
    times = log.depth.capture_s if is_capture else log.depth.arrival_s
    if times is None:
        return None
    rows = np.linspace(0, log.depth.depth_mm.shape[1] - 1, DEPTH_GRID).astype(int)
    columns = np.linspace(0, log.depth.depth_mm.shape[2] - 1, DEPTH_GRID).astype(int)
    predicted = _predicted(log, log.base, rows, columns)
    measured: Floats = 1e-3 * log.depth.depth_mm[:, rows][:, :, columns].reshape(
        len(times), -1
    ).astype(np.float64)
    # a pixel that is often invalid, out of range or crossed by an edge shows no time
    reach = NEAR_RANGE * float(camera.get("range_max", 3.0))
    steady = (np.mean(measured > 0, axis=0) > MIN_VALID) & np.all(predicted.values < reach, axis=0)
    predicted_steps = np.diff(
        np.where(np.isfinite(predicted.values), predicted.values, 1e3), axis=0
    )
    steady &= np.abs(predicted_steps).max(axis=0) < JUMP_M
    if not steady.any():
        return None
    for pixel in np.flatnonzero(steady):
        valid = measured[:, pixel] > 0
        measured[:, pixel] = np.interp(times, times[valid], measured[valid, pixel])
    name = "images by capture stamps" if is_capture else "images by arrival"
    stream = MotionSamples(name=name, time_s=times, values=measured[:, steady])
    reference = MotionSamples(
        name="base", time_s=predicted.time_s, values=predicted.values[:, steady]
    )
    return fit_offset(stream, reference, is_relative=True)


def _predicted(log: RunLog, base: LogTable, rows: Indices, columns: Indices) -> MotionSamples:
    """Predicted depth of chosen pixels at poses every `POSES_S`."""
    step = max(1, round(POSES_S / float(np.median(np.diff(base.time_s)))))
    depth = expected_depth(base.values[::step, :7], log, rows, columns)
    return MotionSamples(
        name="base", time_s=base.time_s[::step], values=depth.reshape(len(depth), -1)
    )
