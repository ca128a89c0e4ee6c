"""The IMU problem: what an IMU reports against the motion of its base.

Two signals. The tilt that the IMU reports against the measured one shows how it is mounted, and how late it is. Its
rates, integrated over a second, against how far the base turned show drift and lateness without differentiating noise.
The heading of an IMU is its own and says nothing.
"""

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem import rotations
from saltus.real2sim.problem.imu.windows import BLOCK_STEPS, BLOCKS, STEP_S, WINDOW_STEPS, cut_windows
from saltus.real2sim.problem.log import sampled, segments_of
from saltus.real2sim.problem.problem import LARGEST_RESIDUAL, Candidate, Problem, Unknown, candidate, sought
from saltus.recordings.run_log import RunLog
from saltus.rotations import quaternion_from_roll_pitch_yaw, quaternion_inverse, quaternion_product

SIGNALS = ("tilt_roll", "tilt_pitch", "turn_roll", "turn_pitch", "turn_yaw")
START_RAD = 0.1
"""Where a window starts is not known to the integral of rates: it starts free."""
SMALLEST_RAD = 1e-5
SAMPLING_S = 0.0015
"""Half a step of a simulation at 500 Hz, and some: how far rates and orientation of one row may be apart."""
TYPICAL = {"imu_latency.delay": 0.005, "imu_bias.gyro_x": 0.02, "imu_bias.roll": 0.02}
"""Usual sizes: 2 to 15 ms, 0.01 to 0.05 rad/s, 0.5 to 2 degrees."""
LEAST_SIGMA = 6.0
"""Norm of the whitened change by a typical effect below which nobody could name it."""


def imu_candidates() -> tuple[Candidate, ...]:
    """The effects of an IMU, nuisances last."""
    tilt = [sought(name, 0.01) for name in ("roll", "pitch")]
    axes = [Unknown(name, -0.3, 0.3, 0.02) for name in ("roll", "pitch", "yaw")]
    return (
        candidate("imu_bias", *(sought(f"gyro_{axis}", 0.01) for axis in "xyz"), *tilt, where="imu"),
        candidate("imu_latency", sought("delay", 0.002), where="imu"),
        # a bias of the reported tilt may or may not turn the gyroscope's axes too
        candidate("gyro_axes", *axes, where="imu", is_nuisance=True),
        # a gyroscope's sample may stand for the step before it, or for the one after
        candidate("gyro_sampling", Unknown("lead", -SAMPLING_S, SAMPLING_S, 0.001), where="imu", is_nuisance=True),
    )


class ImuProblem(Problem):
    """One IMU, one block "imu"; `RecordingError` where the log lacks `imu.csv`, or the motion of its base."""

    name = "imu"
    blocks = ("imu",)
    places = ({"imu": "imu"},)
    simulator_disagreement = 0.05
    """Turning is geometry: nothing is integrated but the rates themselves."""

    def __init__(self, log: RunLog) -> None:
        self.segments = segments_of(log)
        self._windows = cut_windows(log, self.segments)
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
        tilt = self._tilt_error(self._base(delay), quaternion_from_roll_pitch_yaw(roll, pitch, zero))
        turn = self._turn_error(self._base(delay - value["gyro_sampling.lead"]), bias, axes)
        whitened = self._whitened(tilt, turn)
        return np.clip(whitened.reshape(len(unknowns), 1, -1), -LARGEST_RESIDUAL, LARGEST_RESIDUAL)

    def _base(self, delay_s: Floats) -> Floats:
        """Orientation of the base `delay_s` before each step, shape (n, w, steps, 4)."""
        at_s = self._windows.step_s - delay_s[:, None, None]
        return rotations.unit(sampled(at_s, *self._windows.base))

    def _tilt_error(self, base: Floats, mount: Floats) -> Floats:
        """Reported minus expected tilt: the rotation vector without its part about the vertical, (n, w, BLOCKS, 2)."""
        reported = rotations.up_in_body(self._windows.orientation)
        expected = rotations.up_in_body(quaternion_product(base, mount[:, None, None]))
        error = np.cross(np.broadcast_to(reported, expected.shape), expected)[..., :2]
        return _means(error)

    def _turn_error(self, base: Floats, bias: Floats, axes: Floats) -> Floats:
        """Integral of the rates minus how far the base turned, in its own frame, shape (n, w, BLOCKS, 3)."""
        turned_axes = rotations.from_vector(axes)
        rate = self._windows.gyro - bias[:, None, None]  # (n, w, steps, 3)
        rate = _turned(turned_axes[:, None, None], rate)
        moves = rotations.from_vector(0.5 * STEP_S * (rate[..., 1:, :] + rate[..., :-1, :]))
        path = np.empty(base.shape)
        path[..., 0, :] = base[..., 0, :]
        for step in range(WINDOW_STEPS - 1):
            path[..., step + 1, :] = quaternion_product(path[..., step, :], moves[..., step, :])
        return _means(rotations.to_vector(quaternion_product(quaternion_inverse(base), path)))

    def _roots(self) -> tuple[Floats, Floats]:
        """Roots that make windows white: tilt and turn about roll and pitch, and turn about yaw alone.

        Inverse Cholesky factors of their covariance, shapes (w, 2, 2 BLOCKS, 2 BLOCKS) and (w, BLOCKS, BLOCKS). Both
        signals have the noise of the base in common. The integral of the rates has that of a random walk.
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
        roll_and_pitch, yaw = (np.linalg.inv(np.linalg.cholesky(each)) for each in (both, turn[:, 2]))
        return roll_and_pitch, yaw

    def _whitened(self, tilt: Floats, turn: Floats) -> Floats:
        """Shape (n, w, 5, BLOCKS)."""
        pairs = [np.concatenate([tilt[..., axis], turn[..., axis]], axis=-1) for axis in (0, 1)]
        roll, pitch = (
            np.einsum("wij,nwj->nwi", self._tilt[:, axis], pair).reshape(*pair.shape[:-1], 2, BLOCKS)
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
            found["imu_bias"] = f"0.02 rad/s would move all residuals by {sizes['imu_bias.gyro_x']:.1f} sigma"
        return found


def _covariance(sigma: float, correlation: float) -> Floats:
    lag = np.abs(np.arange(BLOCKS)[:, None] - np.arange(BLOCKS))
    return np.asarray(max(sigma, SMALLEST_RAD) ** 2 * correlation**lag)


def _means(values: Floats) -> Floats:
    """Means over blocks, shape (..., steps, k) -> (..., BLOCKS, k)."""
    return np.asarray(values.reshape(*values.shape[:-2], BLOCKS, BLOCK_STEPS, values.shape[-1]).mean(axis=-2))


def _turned(quaternion: Floats, vector: Floats) -> Floats:
    """Vectors turned by quaternions."""
    axis = quaternion[..., 1:]
    twice = 2.0 * np.cross(np.broadcast_to(axis, vector.shape), vector)
    return np.asarray(vector + quaternion[..., :1] * twice + np.cross(np.broadcast_to(axis, vector.shape), twice))
