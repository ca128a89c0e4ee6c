"""A log's IMU and the motion of its base, cut into windows over which rates are integrated."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.constants import PHYSICS_DT
from saltus.effects.imu import ImuLatency
from saltus.errors import RecordingError
from saltus.real2sim.problem import rotations
from saltus.real2sim.problem.log import sampled
from saltus.real2sim.problem.problem import Segment
from saltus.real2sim.problem.stream_noise import StreamNoise, quiet_sigma, read_noise, rotation_columns
from saltus.recordings.run_log import RunLog
from saltus.rotations import quaternion_inverse, quaternion_product

STEP_S = PHYSICS_DT
BLOCK_STEPS = 10
"""Residuals are means over 20 ms: bodies turn below 10 Hz, and sensors average out."""
BLOCKS = 50
"""Blocks of a window, 1 s: a bias of the gyroscope grows to an angle, its noise does not yet."""
WINDOW_STEPS = BLOCKS * BLOCK_STEPS
WINDOWS = 40
"""At most this many, spread over the log: 40 s tell all that there is to tell."""
LONGEST_DELAY_S = ImuLatency.sought("delay")[1]
GAP_S = 0.05
"""Windows in which the base is not measured for so long are left out."""
REST_RATIO = 1.3
"""A held base that swings is left out: its gyroscope is this much louder than in its quietest second, where noise
alone varies by a few per cent."""
JUMP = 4.0
"""Times the noise of the mismatch of rates and turning: a foot landed between two samples."""
SHORTEST_S = 1e-6
"""Between two samples: rows may bear one time."""
STEADY_RAD = 1e-5
"""Noise of an orientation that is not measured but known: below all sensors."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ImuWindows:
    """Readings of IMU and motion capture; w windows.

    Attributes:
        start_s: Shape (w,).
        segment: Index of the segment of each, shape (w,).
        gyro: Rates at every step [rad/s], shape (w, WINDOW_STEPS, 3).
        jumped: Variance that the integral of rates has gained since the start by jumps between samples [rad^2], shape
            (w, WINDOW_STEPS, 3).
        orientation: As the IMU reports it, shape (w, WINDOW_STEPS, 4).
        base: Rows of the measured orientation, which is read at any time; times of shape (n,), quaternions (n, 4).
        noise: Of the IMU's orientation, its rates, and the base's orientation.
    """

    start_s: Floats
    segment: Indices
    gyro: Floats
    jumped: Floats
    orientation: Floats
    base: tuple[Floats, Floats]
    noise: tuple[StreamNoise, StreamNoise, StreamNoise]

    @property
    def block_s(self) -> Floats:
        """Middle of each block, shape (w, BLOCKS)."""
        return np.asarray(self.start_s[:, None] + (np.arange(BLOCKS) + 0.5) * BLOCK_STEPS * STEP_S)

    @property
    def step_s(self) -> Floats:
        """Times of the steps, shape (w, WINDOW_STEPS)."""
        return np.asarray(self.start_s[:, None] + np.arange(WINDOW_STEPS) * STEP_S)


def cut_windows(log: RunLog, segments: Sequence[Segment]) -> ImuWindows:
    """Cuts a log; `RecordingError` without an IMU, or a second in which the motion of the base is known."""
    if log.imu is None:
        raise RecordingError("the log has no imu.csv")
    time_s, values = log.imu.time_s, log.imu.values
    orientation = rotations.continuous(values[:, :4])
    noise = (read_noise(time_s, rotation_columns(orientation)), read_noise(time_s, values[:, 4:7]))
    if log.base is not None:
        base = (log.base.time_s, rotations.continuous(log.base.values[:, 3:7]))
        reference = read_noise(base[0], rotation_columns(base[1]))
        places = _places(segments, base[0])
    elif log.meta["base"] != "fixed":
        raise RecordingError("the base is not held, and no base.csv says how it moves")
    else:  # a held base is level and does not turn
        base = (time_s[[0, -1]], np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)))
        reference = StreamNoise(sigma=STEADY_RAD, correlation=0.0, dt_s=STEP_S)
        places = _at_rest(_places(segments, time_s), time_s, values[:, 4:7])
    if not places:
        raise RecordingError("no second of the log in which the motion of the base is known")
    mismatch, missed = _mismatch(time_s, values[:, 4:7], base)
    gained = np.cumsum(np.pad((missed * np.diff(time_s)[:, None]) ** 2, ((1, 0), (0, 0))), axis=0)
    # a robot that jumps turns too quickly for the noise of its rates to be told from its motion
    gyro_noise = min(noise[1], read_noise(time_s[1:], mismatch), key=lambda each: each.sigma)
    start_s = np.array([start for _, start in places])
    steps = start_s[:, None] + np.arange(WINDOW_STEPS) * STEP_S
    jumped = sampled(steps, time_s, gained)
    return ImuWindows(
        start_s=start_s,
        segment=np.array([segment for segment, _ in places], dtype=np.int64),
        gyro=sampled(steps, time_s, values[:, 4:7]),
        jumped=jumped - jumped[:, :1],
        orientation=rotations.unit(sampled(steps, time_s, orientation)),
        base=base,
        noise=(noise[0], gyro_noise, reference),
    )


def _mismatch(time_s: Floats, gyro: Floats, base: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Rates from sample to sample less those of the base, in two parts [rad/s], shape (n - 1, 3) each.

    The first is noise and bias. The second is what was missed where a foot landed between two samples, of which the log
    does not say when.
    """
    turned = rotations.unit(sampled(time_s, *base))
    moves = rotations.to_vector(quaternion_product(quaternion_inverse(turned[:-1]), turned[1:]))
    rate = 0.5 * (gyro[1:] + gyro[:-1]) - moves / np.maximum(np.diff(time_s), SHORTEST_S)[:, None]
    usual = np.median(rate, axis=0)
    missed = np.where(np.abs(rate - usual) > JUMP * quiet_sigma(rate - usual), rate - usual, 0.0)
    return np.asarray(rate - missed), missed


def _places(segments: Sequence[Segment], time_s: Floats) -> list[tuple[int, float]]:
    """Segment and start [s] of each window; later by the longest delay than the segment, so that it has a past."""
    length = WINDOW_STEPS * STEP_S
    counts = [max(0, int((s.end_s - s.start_s - LONGEST_DELAY_S + 1e-6) / length)) for s in segments]
    every = max(1, int(np.ceil(sum(counts) / WINDOWS)))
    gaps = time_s[1:][np.diff(time_s) > GAP_S]
    places = []
    for i, (segment, count) in enumerate(zip(segments, counts, strict=True)):
        for k in range(0, count, every):
            start = segment.start_s + LONGEST_DELAY_S + k * length
            if not np.any((gaps > start - LONGEST_DELAY_S) & (gaps < start + length + GAP_S)):
                places.append((i, start))
    return places


def _at_rest(places: Sequence[tuple[int, float]], time_s: Floats, gyro: Floats) -> list[tuple[int, float]]:
    """Those windows in which the base does not turn."""
    loud = []
    for _, start in places:
        rows = gyro[(time_s >= start) & (time_s < start + WINDOW_STEPS * STEP_S)]
        loud.append(float(np.max(np.std(rows, axis=0))) if len(rows) else np.inf)
    return [place for place, level in zip(places, loud, strict=True) if level <= REST_RATIO * min(loud)]
