"""Noise of a stream of a log, estimated from frequencies above those of motion."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter
from scipy.stats import norm

from saltus.arrays import Floats

MEAN_S = 0.02
"""Noise is estimated from means over this time, because residuals are made of such means. Cables
and belts ring and sensors have filters, so rows say little above 25 Hz about what remains in
means."""
HIGH_PASS_MEANS, HIGH_PASS_ORDER = 9, 5
"""Noise is what a quintic through 9 means, 0.18 s, does not follow: frequencies above about 12
Hz."""
STRETCH_MEANS = 40
QUIET_SHARE, QUIET_RATIO = 0.2, 1.3
"""Only stretches with at most `QUIET_RATIO` times the power at the rank `QUIET_SHARE` count: this
leaves out impacts and keeps all stretches of pure noise."""
CORRELATION_RANGE = (-0.4, 0.4)
"""Range of the correlation from mean to mean: a corner frequency of 7 Hz to ringing just above 25
Hz. Slower noise cannot be told from motion."""


@dataclass(frozen=True, kw_only=True)
class StreamNoise:
    """Noise of a measured stream as first-order noise: white noise through a low-pass filter."""

    sigma: float
    """Standard deviation of a sample."""
    correlation: float
    """Correlation of successive samples."""
    dt_s: float
    """Time between samples."""

    @property
    def density(self) -> float:
        """Growth of the variance of the noise's integral per second."""
        return self.sigma**2 * self.dt_s * (1.0 + self.correlation) / (1.0 - self.correlation)

    def of_means(self, duration_s: float) -> tuple[float, float]:
        """Standard deviation of means over `duration_s` and the correlation of successive means."""
        rows = max(1, round(duration_s / self.dt_s))
        lag = np.arange(rows)
        same = np.sum(self.correlation ** np.abs(lag[:, None] - lag)) / rows**2
        following = np.sum(self.correlation ** (rows + lag[:, None] - lag)) / rows**2
        return self.sigma * float(np.sqrt(same)), float(following / same)


def read_stream_noise(time_s: Floats, values: Floats) -> StreamNoise:
    """Noise of a stream whose columns are alike, from means over `MEAN_S`;
    `values` has shape (n, columns).

    Streams with longer time steps are used as they are. At least 0.2 s are needed.
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


def quiet_sigma(values: Floats) -> float:
    """Standard deviation of white noise beside which something else is there
    in all but a share of the time.
    """
    return float(np.quantile(np.abs(values), QUIET_SHARE) / norm.ppf(0.5 + 0.5 * QUIET_SHARE))


def rotation_columns(quaternion: Floats) -> Floats:
    """Columns with the noise of the rotation vector [rad]:
    four components share the noise of three axes.
    """
    return np.asarray(2.0 * np.sqrt(4.0 / 3.0) * quaternion)


def _before_high_pass(power: float, product: float) -> tuple[float, float]:
    """Standard deviation and correlation of first-order noise
    from its power and lagged product after the high pass.
    """
    passed = np.eye(HIGH_PASS_MEANS)[HIGH_PASS_MEANS // 2] - savgol_coeffs(
        HIGH_PASS_MEANS, HIGH_PASS_ORDER
    )
    lags = np.arange(-HIGH_PASS_MEANS, HIGH_PASS_MEANS + 1)
    spread = np.correlate(passed, passed, mode="full")
    correlation = np.linspace(*CORRELATION_RANGE, 200)
    of_lag = correlation[:, None] ** np.abs(lags)
    after = np.stack([of_lag[:, 1:-1] @ spread, of_lag[:, 2:] @ spread])
    found = float(np.interp(product / max(power, 1e-30), after[1] / after[0], correlation))
    return float(np.sqrt(power / np.interp(found, correlation, after[0]))), found
