"""Noise of the inverse depth over time: how strong, against range,
and how correlated in time and in the image.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Reals
from saltus.render.stereo.static_scene import (
    StaticScene,
    StereoEstimate,
    stereo_estimate,
    untestable_estimate,
)

MIN_FRAMES = 10  # for a variance over time
MIN_PIXELS = 200
RANGES = 12  # bins of depth, equally wide in its logarithm
LAGS_PX = 30
LAGS_FRAMES = 8
ONE_RANGE = 1.3  # farthest over nearest: below, the growth with range cannot be seen
# Pixels that share one independent value of the noise, for standard errors: 10 x 10 (D435)
CORRELATED_PX = 100.0


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseCurves:
    """Noise of a recorded stereo camera against depth, as measured."""

    range_m: Floats
    """Middle of each bin that has enough pixels [m], shape (n,)."""
    sigma_m: Floats
    """Standard deviation of depth in it, depth unit and disparity step included [m], shape (n,)."""
    lag_s: Reals
    """Shape (k,)."""
    correlation_in_time: Floats
    """At these lags."""
    lag_px: Floats
    """Shape (m,)."""
    correlation_in_image: Floats
    """At these lags, mean of along rows and along columns."""
    variance_inverse: float
    """Variance of the inverse depth [1/m^2], less the share of the depth unit."""
    unit_variance: float
    """Share of the depth unit [1/m^2]."""
    sequential: float
    """Correlation of neighbouring frames."""


def noise_curves(scene: StaticScene) -> NoiseCurves | str:
    """Measures the noise; a reason where that cannot be done."""
    if scene.frames < MIN_FRAMES:
        return (
            f"{scene.frames} frames of a scene at rest: "
            f"{MIN_FRAMES} are needed for a variance over time"
        )
    count = int(np.sum(scene.surface))
    if count < MIN_PIXELS:
        return (
            f"{count} pixels on surfaces away from edges are always valid: {MIN_PIXELS} are needed"
        )
    values = scene.inverse[:, scene.surface].astype(np.float64)
    residual = values - np.mean(values, axis=0)
    sequence = _autocovariance(residual)
    in_image = _image_covariance(scene, residual)
    unit = _unit_variance(scene, values)
    variance = sequence[0] - unit
    bins, sigma = _against_range(values, sequence[0] / np.mean(np.var(values, axis=0)))
    return NoiseCurves(
        range_m=bins,
        sigma_m=sigma,
        lag_s=scene.period_s * np.arange(len(sequence)),
        correlation_in_time=sequence / sequence[0],
        lag_px=np.arange(len(in_image), dtype=float),
        correlation_in_image=in_image,
        variance_inverse=float(variance),
        unit_variance=unit,
        sequential=float(sequence[1] / variance),
    )


def sigma_inverse(
    curves: NoiseCurves, scene: StaticScene, step_inverse: StereoEstimate
) -> StereoEstimate:
    """Sub-pixel noise as noise of the inverse depth [1/m],
    without the share of the disparity step.
    """
    variance = curves.variance_inverse - (step_inverse.value or 0.0) ** 2 / 12.0
    if variance <= 0.0:
        return untestable_estimate("the noise is below the disparity step")
    value = math.sqrt(variance)
    # independent values: patches of the image, and frames as far apart as the noise remembers
    memory = (1.0 + curves.sequential) / max(1e-3, 1.0 - curves.sequential)
    independent = max(1.0, float(np.sum(scene.surface)) / CORRELATED_PX * scene.frames / memory)
    # rounding to so coarse a unit is not even: its share of the variance may be off by as much as
    # itself
    uneven = 0.5 * curves.unit_variance / variance
    return stereo_estimate(value, value * math.hypot(1.0 / math.sqrt(2.0 * independent), uneven))


def noise_persistence(
    curves: NoiseCurves, scene: StaticScene, step_inverse: StereoEstimate
) -> StereoEstimate:
    """Time in which the noise falls to 1/e [s]."""
    variance = curves.variance_inverse - (step_inverse.value or 0.0) ** 2 / 12.0
    kept = (
        float(curves.correlation_in_time[1])
        * (curves.variance_inverse + curves.unit_variance)
        / variance
    )
    if not 0.02 < kept < 0.98:
        side = (
            "shorter than the frames are apart"
            if kept <= 0.02
            else "longer than the recording can show"
        )
        return untestable_estimate(
            f"neighbouring frames correlate by {kept:.2f}: the memory of the noise is {side}"
        )
    value = -scene.period_s / math.log(kept)
    error = 1.0 / math.sqrt(scene.frames * max(1.0, float(np.sum(scene.surface)) / CORRELATED_PX))
    return stereo_estimate(value, value * error / (kept * abs(math.log(kept))))


def correlation_px(curves: NoiseCurves, step_inverse: StereoEstimate) -> StereoEstimate:
    """Lag in the image at which the correlation has fallen to 1/e [px]."""
    total = curves.variance_inverse + curves.unit_variance
    signal = (curves.variance_inverse - (step_inverse.value or 0.0) ** 2 / 12.0) / total
    correlation = curves.correlation_in_image / signal
    below = np.flatnonzero(correlation < math.exp(-1.0))
    below = below[below > 0]
    if not below.size:
        return untestable_estimate(
            f"the noise is correlated over more than {len(correlation) - 1} pixels, or surfaces "
            "are small"
        )
    k = int(below[0])
    before = 1.0 if k == 1 else float(correlation[k - 1])
    share = (before - math.exp(-1.0)) / (before - float(correlation[k]))
    return stereo_estimate(k - 1 + share, 0.5)


def _autocovariance(residual: Floats) -> Floats:
    """Covariance over lags [frames], corrected for the mean that was taken from the same frames."""
    frames = len(residual)
    lags = range(min(LAGS_FRAMES, frames - 2) + 1)
    raw = np.array([np.mean(residual[k:] * residual[: frames - k]) for k in lags])
    found = raw.copy()
    for _ in range(
        20
    ):  # the mean varies by what the covariance says; converges by frames over memory each time
        memory = min(0.95, max(0.0, found[1] / found[0]))
        mean_variance = found[0] / frames * (1.0 + memory) / (1.0 - memory)
        found = raw + mean_variance
    return found


def _image_covariance(scene: StaticScene, residual: Floats) -> Floats:
    """Correlation over lags in the image, shape (lags + 1,)."""
    height, width = scene.surface.shape
    image = np.zeros((scene.frames, height, width), dtype=np.float32)
    image[:, scene.surface] = residual
    variance = float(np.mean(residual**2))
    result = [1.0]
    for lag in range(1, min(LAGS_PX, height - 1, width - 1) + 1):
        found = []
        for here, there in (
            ((slice(None), slice(lag, None)), (slice(None), slice(None, -lag))),
            ((slice(lag, None), slice(None)), (slice(None, -lag), slice(None))),
        ):
            pairs = int(np.sum(scene.surface[here] & scene.surface[there]))
            if pairs >= MIN_PIXELS:
                found.append(
                    float(np.vdot(image[(slice(None), *here)], image[(slice(None), *there)]))
                    / pairs
                )
        if not found:
            break
        result.append(float(np.mean(found)) / scene.frames / variance)
    return np.array(result)


def _unit_variance(scene: StaticScene, values: Floats) -> float:
    """Mean variance that rounding to the depth unit adds to the inverse depth."""
    return float(np.mean((scene.unit_m * np.mean(values, axis=0) ** 2) ** 2) / 12.0)


def _against_range(values: Floats, correction: float) -> tuple[Floats, Floats]:
    inverse = np.mean(values, axis=0)
    depth = 1.0 / inverse
    sigma = np.sqrt(np.var(values, axis=0) * correction) * depth**2
    edges = np.geomspace(depth.min(), depth.max() * 1.001, RANGES + 1)
    place = np.digitize(depth, edges) - 1
    used: list[tuple[float, float]] = []
    for k in range(RANGES):
        inside: NDArray[np.bool_] = place == k
        if np.sum(inside) >= MIN_PIXELS:
            used.append(
                (float(np.median(depth[inside])), float(np.sqrt(np.mean(sigma[inside] ** 2))))
            )
    pairs = np.array(used).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def range_exponent(curves: NoiseCurves) -> StereoEstimate:
    """Exponent of the growth of the noise with range; 2 for stereo."""
    if len(curves.range_m) < 2 or curves.range_m[-1] < ONE_RANGE * curves.range_m[0]:
        return untestable_estimate("all surfaces are at one range")
    slope, covariance = np.polyfit(
        np.log(curves.range_m), np.log(curves.sigma_m), 1, cov="unscaled"
    )
    return stereo_estimate(float(slope[0]), 0.05 * math.sqrt(float(covariance[0, 0])))
