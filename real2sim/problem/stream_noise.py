"""How noisy a stream of a log is, read from what is quicker than any motion in it."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from saltus.arrays import Floats

MEAN_S = 0.02
"""Noise is read from means over so long, as those are what residuals are made of: cables and belts ring, filters of
sensors have any shape, and what rows have among them above 25 Hz says little of what is left of it in means."""
HIGH_PASS_MEANS, HIGH_PASS_ORDER = 9, 5
"""Noise is what a quintic through 9 means, 0.18 s, does not follow: beyond about 12 Hz."""
STRETCH_MEANS = 40
QUIET_SHARE, QUIET_RATIO = 0.2, 1.3
"""Noise is read from stretches that have at most so many times the power of the one at this rank: impacts are not
noise, and of noise itself no part is left out."""
CORRELATION_RANGE = (-0.4, 0.4)
"""From mean to mean: a corner of 7 Hz, or ringing just beyond 25 Hz. What is slower is not told from motion."""


@dataclass(frozen=True, kw_only=True)
class StreamNoise:
    """Noise of first order: white noise through a low-pass."""

    sigma: float
    """Standard deviation of a sample."""
    correlation: float
    """From sample to sample."""
    dt_s: float
    """Between samples."""

    @property
    def density(self) -> float:
        """Variance of the noise's integral, per second."""
        return self.sigma**2 * self.dt_s * (1.0 + self.correlation) / (1.0 - self.correlation)

    def of_means(self, duration_s: float) -> tuple[float, float]:
        """Standard deviation of means over `duration_s`, and their correlation from one to the next."""
        rows = max(1, round(duration_s / self.dt_s))
        lag = np.arange(rows)
        same = np.sum(self.correlation ** np.abs(lag[:, None] - lag)) / rows**2
        following = np.sum(self.correlation ** (rows + lag[:, None] - lag)) / rows**2
        return self.sigma * float(np.sqrt(same)), float(following / same)


def read_noise(time_s: Floats, values: Floats) -> StreamNoise:
    """Noise of means over `MEAN_S` of a stream whose columns are alike; `values` of shape (n, columns), 0.2 s or more.

    Slower streams are taken as they are.
    """
    dt_s = float(np.median(np.diff(time_s)))
    rows = max(1, round(MEAN_S / dt_s))
    count = len(values) // rows
    means = values[: count * rows].reshape(count, rows, -1).mean(axis=1)
    rough = means - savgol_filter(means, HIGH_PASS_MEANS, HIGH_PASS_ORDER, axis=0)
    parts = np.array_split(rough, max(1, count // STRETCH_MEANS))
    power = np.array([np.mean(part**2) for part in parts])
    product = np.array([np.mean(part[1:] * part[:-1]) for part in parts])
    quiet = power <= QUIET_RATIO * np.quantile(power, QUIET_SHARE)
    sigma, correlation = _before_high_pass(float(power[quiet].mean()), float(product[quiet].mean()))
    return StreamNoise(sigma=sigma, correlation=correlation, dt_s=rows * dt_s)


def rotation_columns(quaternion: Floats) -> Floats:
    """Columns whose noise is that of the rotation vector [rad]: four components share the noise of three axes."""
    return np.asarray(2.0 * np.sqrt(4.0 / 3.0) * quaternion)


def _before_high_pass(power: float, product: float) -> tuple[float, float]:
    """Standard deviation and correlation of first-order noise with `power` and lagged `product` after the filter."""
    passed = np.eye(HIGH_PASS_MEANS)[HIGH_PASS_MEANS // 2] - savgol_coeffs(HIGH_PASS_MEANS, HIGH_PASS_ORDER)
    lags = np.arange(-HIGH_PASS_MEANS, HIGH_PASS_MEANS + 1)
    spread = np.correlate(passed, passed, mode="full")
    correlation = np.linspace(*CORRELATION_RANGE, 200)
    of_lag = correlation[:, None] ** np.abs(lags)
    after = np.stack([of_lag[:, 1:-1] @ spread, of_lag[:, 2:] @ spread])
    found = float(np.interp(product / max(power, 1e-30), after[1] / after[0], correlation))
    return float(np.sqrt(power / np.interp(found, correlation, after[0]))), found
