"""The step of the disparity from the comb that it leaves in the distribution of inverse depth."""

import numpy as np

from saltus.arrays import Floats
from saltus.render.stereo.static_scene import (
    StaticScene,
    StereoEstimate,
    stereo_estimate,
    untestable_estimate,
)

BINS = 1 << 18
SAMPLES = 2_000_000  # inverse depths that are looked at
# Of depth: near surfaces are left out in turn
QUANTILES = (
    0.0,
    0.25,
    0.5,
    0.75,
    0.85,
    0.9,
    0.95,
    0.97,
    0.98,
    0.99,
)
ENVELOPE = 0.6  # beyond 0.6 / sigma a Gaussian's spectrum is below 1e-3
UNIT_MARGIN = 0.85  # the depth unit makes a comb of its own, from 1 / (unit w^2) on
PROMINENCE = (
    10.0  # peak over median of the spectrum, added up over all cuts that show the same line
)
SAME_LINE = 0.02
MIN_CUTS = 2
# Peak over median in at least one cut: without a comb the strongest of all lines stays below 4
CLEAR = 5.0
MIN_LINES = 4.0  # of the comb within the range of inverse depths


def fit_step(scene: StaticScene, sigma_inverse: float) -> StereoEstimate:
    """Step of the inverse depth [1/m]: disparity step over f B;
    `sigma_inverse` is its noise [1/m].
    """
    if not np.any(scene.surface):
        return untestable_estimate("no surface away from edges is valid throughout")
    stride = max(1, scene.frames * int(np.sum(scene.surface)) // SAMPLES)
    values = scene.inverse[:, scene.surface][::stride].ravel().astype(np.float64)
    lines = np.array(
        [_strongest_line(values, quantile, sigma_inverse, scene.unit_m) for quantile in QUANTILES]
    )
    # the comb is there whichever surfaces are left out; products with the depth unit's own comb are
    # not
    alike = np.abs(lines[:, None, 1] - lines[None, :, 1]) < SAME_LINE * lines[:, None, 1]
    support = alike @ lines[:, 0]
    chosen = alike[int(np.argmax(support))]
    if (
        np.max(support) < PROMINENCE
        or np.sum(chosen) < MIN_CUTS
        or np.max(lines[chosen, 0]) < CLEAR
    ):
        return untestable_estimate(
            "no comb in the inverse depths: surfaces are so near that the depth unit hides the "
            "step, or the noise is "
            "below the step"
        )
    _, frequency, resolution = max(lines[chosen], key=lambda line: float(line[0]))
    return stereo_estimate(1.0 / float(frequency), float(resolution) / float(frequency) ** 2)


def _strongest_line(
    values: Floats, quantile: float, sigma: float, unit_m: float
) -> tuple[float, float, float]:
    """Prominence, frequency [m], and its error,
    of the strongest line of the spectrum of all that is far enough.
    """
    far = values[values <= np.quantile(values, 1.0 - quantile)]
    low, high = float(far.min()), float(far.max())
    span = high - low
    # a span that holds few lines has been cut out of one surface: its ends would ring
    if span <= 0.0:
        return 0.0, 0.0, 0.0
    density, _ = np.histogram(far, bins=BINS, range=(low, high))
    window = np.hanning(BINS) if quantile > 0.0 else np.ones(BINS)
    spectrum = np.abs(np.fft.rfft(density * window, 2 * BINS))
    frequency = np.arange(len(spectrum)) / (2.0 * span)
    searched = (frequency > max(ENVELOPE / sigma, MIN_LINES / span)) & (
        frequency < UNIT_MARGIN / (unit_m * high**2)
    )
    if np.sum(searched) < 16:
        return 0.0, 0.0, 0.0
    index = np.flatnonzero(searched)
    peak = int(index[np.argmax(spectrum[index])])
    floor = float(np.median(spectrum[index])) + 1e-9
    if not 0 < peak < len(spectrum) - 1:
        return 0.0, 0.0, 0.0
    before, at, after = spectrum[peak - 1 : peak + 2]
    curvature = before - 2.0 * at + after
    offset = 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0
    exact = (peak + float(np.clip(offset, -0.5, 0.5))) / (2.0 * span)
    prominence = float(at) / floor
    return prominence, exact, 1.0 / (span * prominence)
