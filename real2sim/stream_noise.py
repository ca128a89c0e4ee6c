"""How noisy a stream of a log is, read from what is quicker than any motion in it."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from real2sim.problem import Floats

HIGH_PASS_ROWS, HIGH_PASS_ORDER = 15, 3
"""Noise is what a cubic through 15 rows, 30 ms at 500 Hz, does not follow."""
STRETCH_ROWS = 100
QUIET_SHARE, QUIET_RATIO = 0.3, 1.3
"""Noise is read from stretches that have at most so many times the power of the one at this rank: impacts are not
noise, and of noise itself no part is left out."""
LARGEST_CORRELATION = 0.98
"""From row to row: a corner of 2 Hz at 500 Hz. What is slower than a motion leaves nothing above the high-pass."""


@dataclass(frozen=True, kw_only=True)
class StreamNoise:
    """Noise of first order: white noise through a low-pass."""

    sigma: float
    """Standard deviation of a row."""
    correlation: float
    """From row to row."""
    dt_s: float
    """Between rows."""

    @property
    def density(self) -> float:
        """Variance of the noise's integral, per second."""
        return self.sigma**2 * self.dt_s * (1.0 + self.correlation) / (1.0 - self.correlation)

    def of_means(self, duration_s: float) -> tuple[float, float]:
        """Standard deviation of means over `duration_s` of rows, and their correlation from one to the next."""
        rows = max(1, round(duration_s / self.dt_s))
        lag = np.arange(rows)
        same = np.sum(self.correlation ** np.abs(lag[:, None] - lag)) / rows**2
        following = np.sum(self.correlation ** (rows + lag[:, None] - lag)) / rows**2
        return self.sigma * float(np.sqrt(same)), float(following / same)


def read_noise(time_s: Floats, values: Floats) -> StreamNoise:
    """Noise of a stream whose columns are alike; `values` of shape (n, columns), n at least 15."""
    rough = values - savgol_filter(values, HIGH_PASS_ROWS, HIGH_PASS_ORDER, axis=0)
    count = max(1, len(rough) // STRETCH_ROWS)
    parts = np.array_split(rough, count)
    power = np.array([np.mean(part**2) for part in parts])
    product = np.array([np.mean(part[1:] * part[:-1]) for part in parts])
    quiet = power <= QUIET_RATIO * np.quantile(power, QUIET_SHARE)
    sigma, correlation = _before_high_pass(float(power[quiet].mean()), float(product[quiet].mean()))
    return StreamNoise(sigma=sigma, correlation=correlation, dt_s=float(np.median(np.diff(time_s))))


def rotation_columns(quaternion: Floats) -> Floats:
    """Columns whose noise is that of the rotation vector [rad]: four components share the noise of three axes."""
    return np.asarray(2.0 * np.sqrt(4.0 / 3.0) * quaternion)


def _before_high_pass(power: float, product: float) -> tuple[float, float]:
    """Standard deviation and correlation of first-order noise with `power` and lagged `product` after the filter."""
    passed = np.eye(HIGH_PASS_ROWS)[HIGH_PASS_ROWS // 2] - savgol_coeffs(HIGH_PASS_ROWS, HIGH_PASS_ORDER)
    lags = np.arange(-HIGH_PASS_ROWS, HIGH_PASS_ROWS + 1)
    spread = np.correlate(passed, passed, mode="full")
    correlation = np.linspace(0.0, LARGEST_CORRELATION, 200)
    of_lag = correlation[:, None] ** np.abs(lags)
    after = np.stack([of_lag[:, 1:-1] @ spread, of_lag[:, 2:] @ spread])
    found = float(np.interp(product / max(power, 1e-30), after[1] / after[0], correlation))
    return float(np.sqrt(power / np.interp(found, correlation, after[0]))), found
