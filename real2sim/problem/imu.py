"""The IMU problem: what an IMU reports against the motion of its base.

Two signals. The tilt that the IMU reports against the measured one shows how it is mounted, and how
late it is. Its rates, integrated over a second, against how far the base turned show drift and
lateness without differentiating noise. The heading of an IMU is its own and says nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.constants import PHYSICS_DT
from saltus.effects.imu import ImuLatency
from saltus.errors import RecordingError
from saltus.real2sim.problem import quaternions
from saltus.real2sim.problem.log import interpolate_columns, segments_of
from saltus.real2sim.problem.problem import (
    LARGEST_RESIDUAL,
    LEAST_SIGMA,
    Candidate,
    LogSegment,
    Problem,
    Unknown,
    make_candidate,
    parameter_unknown,
)
from saltus.real2sim.problem.stream_noise import (
    StreamNoise,
    quiet_sigma,
    read_stream_noise,
    rotation_columns,
)
from saltus.recordings.run_log import RunLog
from saltus.rotations import (
    quaternion_from_roll_pitch_yaw,
    quaternion_from_vector,
    quaternion_inverse,
    quaternion_product,
)

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
"""A held base that swings is left out: its gyroscope is this much louder than in its quietest
second, where noise alone varies by a few per cent."""
JUMP = 4.0
"""Times the noise of the mismatch of rates and turning: a foot landed between two samples."""
SHORTEST_S = 1e-6
"""Between two samples: rows may bear one time."""
STEADY_RAD = 1e-5
"""Noise of an orientation that is not measured but known: below all sensors."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ImuWindows:
    """Windows of readings of IMU and motion capture; w windows.

    Attributes:
        start_s: Shape (w,).
        segment: Index of the segment of each, shape (w,).
        gyro: Rates at every step [rad/s], shape (w, WINDOW_STEPS, 3).
        jumped: Variance that the integral of rates has gained since the start by jumps between
            samples [rad^2], shape (w, WINDOW_STEPS, 3).
        orientation: As the IMU reports it, shape (w, WINDOW_STEPS, 4).
        base: Rows of the measured orientation, which is read at any time; times of shape (n,),
            quaternions (n, 4).
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


def imu_windows(log: RunLog, segments: Sequence[LogSegment]) -> ImuWindows:
    """Cuts windows of 1 s in which the motion of the base is known, read at each step of 2 ms.

    At most `WINDOWS`, spread over the log; of a held base those alone in which it rests.

    Raises:
        RecordingError: no IMU; a base that is neither held nor measured; no such second.
    """
    if log.imu is None:
        raise RecordingError("the log has no imu.csv")
    time_s, values = log.imu.time_s, log.imu.values
    orientation = quaternions.continuous_quaternions(values[:, :4])
    noise = (
        read_stream_noise(time_s, rotation_columns(orientation)),
        read_stream_noise(time_s, values[:, 4:7]),
    )
    if log.base is not None:
        base = (log.base.time_s, quaternions.continuous_quaternions(log.base.values[:, 3:7]))
        reference = read_stream_noise(base[0], rotation_columns(base[1]))
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
    gyro_noise = min(noise[1], read_stream_noise(time_s[1:], mismatch), key=lambda each: each.sigma)
    start_s = np.array([start for _, start in places])
    steps = start_s[:, None] + np.arange(WINDOW_STEPS) * STEP_S
    jumped = interpolate_columns(steps, time_s, gained)
    return ImuWindows(
        start_s=start_s,
        segment=np.array([segment for segment, _ in places], dtype=np.int64),
        gyro=interpolate_columns(steps, time_s, values[:, 4:7]),
        jumped=jumped - jumped[:, :1],
        orientation=quaternions.normalise_quaternions(
            interpolate_columns(steps, time_s, orientation)
        ),
        base=base,
        noise=(noise[0], gyro_noise, reference),
    )


def _mismatch(time_s: Floats, gyro: Floats, base: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Rates from sample to sample less those of the base,
    in two parts [rad/s], shape (n - 1, 3) each.

    The first is noise and bias. The second is what was missed where a foot landed between two
    samples, of which the log does not say when.
    """
    turned = quaternions.normalise_quaternions(interpolate_columns(time_s, *base))
    moves = quaternions.to_vector(quaternion_product(quaternion_inverse(turned[:-1]), turned[1:]))
    rate = 0.5 * (gyro[1:] + gyro[:-1]) - moves / np.maximum(np.diff(time_s), SHORTEST_S)[:, None]
    usual = np.median(rate, axis=0)
    missed = np.where(np.abs(rate - usual) > JUMP * quiet_sigma(rate - usual), rate - usual, 0.0)
    return np.asarray(rate - missed), missed


def _places(segments: Sequence[LogSegment], time_s: Floats) -> list[tuple[int, float]]:
    """Segment and start [s] of each window.

    Later by the longest delay than the segment, so that it has a past.
    """
    length = WINDOW_STEPS * STEP_S
    counts = [
        max(0, int((s.end_s - s.start_s - LONGEST_DELAY_S + 1e-6) / length)) for s in segments
    ]
    every = max(1, int(np.ceil(sum(counts) / WINDOWS)))
    gaps = time_s[1:][np.diff(time_s) > GAP_S]
    places = []
    for i, (segment, count) in enumerate(zip(segments, counts, strict=True)):
        for k in range(0, count, every):
            start = segment.start_s + LONGEST_DELAY_S + k * length
            if not np.any((gaps > start - LONGEST_DELAY_S) & (gaps < start + length + GAP_S)):
                places.append((i, start))
    return places


def _at_rest(
    places: Sequence[tuple[int, float]], time_s: Floats, gyro: Floats
) -> list[tuple[int, float]]:
    """Windows in which the base does not turn."""
    loud = []
    for _, start in places:
        rows = gyro[(time_s >= start) & (time_s < start + WINDOW_STEPS * STEP_S)]
        loud.append(float(np.max(np.std(rows, axis=0))) if len(rows) else np.inf)
    return [
        place for place, level in zip(places, loud, strict=True) if level <= REST_RATIO * min(loud)
    ]


SIGNALS = ("tilt_roll", "tilt_pitch", "turn_roll", "turn_pitch", "turn_yaw")
START_RAD = 0.1
"""Where a window starts is not known to the integral of rates: it starts free."""
SMALLEST_RAD = 1e-5
SAMPLING_S = 0.0015
"""Half a step of a simulation at 500 Hz, and some: how far rates and orientation of one row may be
apart."""
TYPICAL = {"imu_latency.delay": 0.005, "imu_bias.gyro_x": 0.02, "imu_bias.roll": 0.02}
"""Usual sizes: 2 to 15 ms, 0.01 to 0.05 rad/s, 0.5 to 2 degrees."""


def imu_candidates() -> tuple[Candidate, ...]:
    """The effects of an IMU, nuisances last."""
    tilt = [parameter_unknown(name, 0.01) for name in ("roll", "pitch")]
    axes = [Unknown(name, -0.3, 0.3, 0.02) for name in ("roll", "pitch", "yaw")]
    return (
        make_candidate(
            "imu_bias",
            *(parameter_unknown(f"gyro_{axis}", 0.01) for axis in "xyz"),
            *tilt,
            where="imu",
        ),
        make_candidate("imu_latency", parameter_unknown("delay", 0.002), where="imu"),
        # a bias of the reported tilt may or may not turn the gyroscope's axes too
        make_candidate("gyro_axes", *axes, where="imu", is_nuisance=True),
        # a gyroscope's sample may stand for the step before it, or for the one after
        make_candidate(
            "gyro_sampling",
            Unknown("lead", -SAMPLING_S, SAMPLING_S, 0.001),
            where="imu",
            is_nuisance=True,
        ),
    )


class ImuProblem(Problem):
    """The problem of the IMU: which errors make it read what a log tells; one block "imu".
    `RecordingError` where the log lacks `imu.csv`, or the motion of its base.
    """

    name = "imu"
    blocks = ("imu",)
    places = ({"imu": "imu"},)
    simulator_disagreement = 0.05
    """Turning is geometry: nothing is integrated but the rates themselves."""

    def __init__(self, log: RunLog) -> None:
        self.segments = segments_of(log)
        self._windows = imu_windows(log, self.segments)
        self.candidates = imu_candidates()
        self._tilt, self._turn = self._roots()
        windows = self._windows
        shape = (len(windows.start_s), len(SIGNALS), BLOCKS)
        self.signals = SIGNALS
        self.segment = np.broadcast_to(windows.segment[:, None, None], shape).ravel()
        self.signal = np.broadcast_to(np.arange(len(SIGNALS))[:, None], shape).ravel()
        self.time_s = np.broadcast_to(windows.block_s[:, None], shape).ravel()
        self.untestable = self._untestable()

    def residuals(self, unknowns: Floats) -> Floats:
        """Whitened residuals, shape (n, 1, m)."""
        value = dict(zip(self.names, unknowns[:, 0].T, strict=True))
        roll, pitch, zero = value["imu_bias.roll"], value["imu_bias.pitch"], np.zeros(len(unknowns))
        bias = np.stack([value[f"imu_bias.gyro_{axis}"] for axis in "xyz"], axis=-1)
        axes = np.stack([value[f"gyro_axes.{name}"] for name in ("roll", "pitch", "yaw")], axis=-1)
        delay = value["imu_latency.delay"]
        tilt = self._tilt_error(
            self._base(delay), quaternion_from_roll_pitch_yaw(roll, pitch, zero)
        )
        turn = self._turn_error(self._base(delay - value["gyro_sampling.lead"]), bias, axes)
        whitened = self._whitened(tilt, turn)
        return np.clip(whitened.reshape(len(unknowns), 1, -1), -LARGEST_RESIDUAL, LARGEST_RESIDUAL)

    def _base(self, delay_s: Floats) -> Floats:
        """Orientation of the base `delay_s` before each step, shape (n, w, steps, 4)."""
        at_s = self._windows.step_s - delay_s[:, None, None]
        return quaternions.normalise_quaternions(interpolate_columns(at_s, *self._windows.base))

    def _tilt_error(self, base: Floats, mount: Floats) -> Floats:
        """Reported minus expected tilt: the rotation vector without its part about the vertical,
        (n, w, BLOCKS, 2).
        """
        reported = quaternions.up_in_body(self._windows.orientation)
        expected = quaternions.up_in_body(quaternion_product(base, mount[:, None, None]))
        error = np.cross(np.broadcast_to(reported, expected.shape), expected)[..., :2]
        return _means(error)

    def _turn_error(self, base: Floats, bias: Floats, axes: Floats) -> Floats:
        """Integral of the rates minus how far the base turned,
        in its own frame, shape (n, w, BLOCKS, 3).
        """
        turned_axes = quaternion_from_vector(axes)
        rate = self._windows.gyro - bias[:, None, None]  # (n, w, steps, 3)
        rate = _turned(turned_axes[:, None, None], rate)
        moves = quaternion_from_vector(0.5 * STEP_S * (rate[..., 1:, :] + rate[..., :-1, :]))
        path = np.empty(base.shape)
        path[..., 0, :] = base[..., 0, :]
        for step in range(WINDOW_STEPS - 1):
            path[..., step + 1, :] = quaternion_product(path[..., step, :], moves[..., step, :])
        return _means(quaternions.to_vector(quaternion_product(quaternion_inverse(base), path)))

    def _roots(self) -> tuple[Floats, Floats]:
        """Roots that make windows white: tilt and turn about roll and pitch,
        and turn about yaw alone.

        Inverse Cholesky factors of their covariance, shapes (w, 2, 2 BLOCKS, 2 BLOCKS) and (w,
        BLOCKS, BLOCKS). Both signals have the noise of the base in common. The integral of the
        rates has that of a random walk.
        """
        imu, gyro, base = self._windows.noise
        block_s = BLOCK_STEPS * STEP_S
        time_s = (np.arange(BLOCKS) + 0.5) * block_s
        gained = gyro.density * time_s[:, None] + _means(self._windows.jumped)  # (w, BLOCKS, 3)
        gained = gained.swapaxes(-1, -2)
        walk = np.minimum(gained[..., :, None], gained[..., None, :])
        shared = _covariance(*base.of_means(block_s))
        own = _covariance(*imu.of_means(block_s))
        turn = shared + walk + START_RAD**2
        both = np.empty((*turn.shape[:-3], 2, 2 * BLOCKS, 2 * BLOCKS))
        both[..., :BLOCKS, :BLOCKS] = own + shared
        both[..., :BLOCKS, BLOCKS:] = both[..., BLOCKS:, :BLOCKS] = shared
        both[..., BLOCKS:, BLOCKS:] = turn[:, :2]
        roll_and_pitch, yaw = (
            np.linalg.inv(np.linalg.cholesky(each)) for each in (both, turn[:, 2])
        )
        return roll_and_pitch, yaw

    def _whitened(self, tilt: Floats, turn: Floats) -> Floats:
        """Shape (n, w, 5, BLOCKS)."""
        pairs = [np.concatenate([tilt[..., axis], turn[..., axis]], axis=-1) for axis in (0, 1)]
        roll, pitch = (
            np.einsum("wij,nwj->nwi", self._tilt[:, axis], pair).reshape(
                *pair.shape[:-1], 2, BLOCKS
            )
            for axis, pair in enumerate(pairs)
        )
        yaw = np.einsum("wij,nwj->nwi", self._turn, turn[..., 2])
        parts = (roll[..., 0, :], pitch[..., 0, :], roll[..., 1, :], pitch[..., 1, :], yaw)
        return np.stack(parts, axis=-2)

    def _untestable(self) -> dict[str, str]:
        """Effects that would not be seen, with the reason."""
        sizes = self.visibility(TYPICAL)
        found = {}
        if sizes["imu_latency.delay"] < LEAST_SIGMA:
            fastest = float(np.max(np.abs(_means(self._windows.gyro))))
            found["imu_latency"] = (
                f"the base turns at most {fastest:.2f} rad/s: 5 ms would move all residuals by "
                f"{sizes['imu_latency.delay']:.1f} sigma"
            )
        if max(sizes["imu_bias.gyro_x"], sizes["imu_bias.roll"]) < LEAST_SIGMA:
            found["imu_bias"] = (
                f"0.02 rad/s would move all residuals by {sizes['imu_bias.gyro_x']:.1f} sigma"
            )
        return found


def _covariance(sigma: float, correlation: float) -> Floats:
    lag = np.abs(np.arange(BLOCKS)[:, None] - np.arange(BLOCKS))
    return np.asarray(max(sigma, SMALLEST_RAD) ** 2 * correlation**lag)


def _means(values: Floats) -> Floats:
    """Means over blocks, shape (..., steps, k) -> (..., BLOCKS, k)."""
    return np.asarray(
        values.reshape(*values.shape[:-2], BLOCKS, BLOCK_STEPS, values.shape[-1]).mean(axis=-2)
    )


def _turned(quaternion: Floats, vector: Floats) -> Floats:
    """Vectors turned by quaternions."""
    axis = quaternion[..., 1:]
    twice = 2.0 * np.cross(np.broadcast_to(axis, vector.shape), vector)
    return np.asarray(
        vector + quaternion[..., :1] * twice + np.cross(np.broadcast_to(axis, vector.shape), twice)
    )
