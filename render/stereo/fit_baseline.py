"""Baseline from what the right imager misses:
the band at the left of the image and the shadows of near things.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Indices
from saltus.render.stereo.optics import BASELINE_M
from saltus.render.stereo.static_scene import (
    StaticScene,
    StereoEstimate,
    stereo_estimate,
    untestable_estimate,
)

SELDOM = 0.05  # a shadow is invalid in every frame; noise at its border lets some through
MIN_WIDTH = 3  # px: narrower ones may be holes at edges
MIN_STEP_PX = 2.0  # of nominal disparity across a shadow
MIN_ROWS = 10
ROUNDING_PX = (
    0.29  # standard deviation of a width in whole pixels, the same in all rows of an upright edge
)
ROWS_ALIKE = 10  # neighbouring rows whose widths err alike: a matching window
NO_MARGIN_PX = 1.5  # a margin that rounding can feign
BESIDE = 2  # pixels from the border of a shadow at which depth is read: clear of flying pixels


@dataclass(frozen=True, kw_only=True, eq=False)
class StereoShadows:
    """Runs of invalid pixels in rows of a recording that the geometry of stereo explains."""

    width: Floats
    """[px], shape (n,)."""
    step: Floats
    """Difference of inverse depth between its sides [1/m]; inverse depth itself for the left band.

    Shape (n,).
    """
    end: Floats
    """First column to the right of it, shape (n,)."""

    def __getitem__(self, index: NDArray[np.bool_] | Indices | slice) -> "StereoShadows":
        return StereoShadows(width=self.width[index], step=self.step[index], end=self.end[index])


def fit_baseline(scene: StaticScene) -> tuple[StereoEstimate, StereoEstimate]:
    """Baseline [m], and the margin [px] of `SearchRange`.

    Shadows are f B (1 / z_near - 1 / z_far) wide. The band is f B / z wide less the margin, so it
    counts for the baseline only where it agrees with the shadows without one, or where there are no
    shadows.
    """
    bands, shadows = left_bands(scene), edge_shadows(scene)
    if len(shadows.width) < MIN_ROWS:
        if len(bands.width) < MIN_ROWS:
            nothing = untestable_estimate(
                "no invalid band at the left of the image and no shadow beside a near edge"
            )
            return nothing, nothing
        note = "from the band at the left alone, taken to be f B / z wide"
        return replace(_slope(bands, scene.fx), note=note), untestable_estimate(
            "no shadow tells band from margin"
        )
    baseline = _slope(shadows, scene.fx)
    if len(bands.width) < MIN_ROWS:
        return baseline, untestable_estimate("no invalid band at the left of the image")
    margin = _margin(bands, scene.fx, baseline)
    if abs(margin.value or 0.0) < NO_MARGIN_PX:
        baseline = _slope(_joined(bands, shadows), scene.fx)
        return baseline, _margin(bands, scene.fx, baseline)
    return baseline, margin


def _margin(bands: StereoShadows, fx: float, baseline: StereoEstimate) -> StereoEstimate:
    rest = fx * (baseline.value or 0.0) * bands.step - bands.width
    return stereo_estimate(
        float(np.median(rest)), max(ROUNDING_PX, 1.25 * float(np.std(rest)) / len(rest) ** 0.5)
    )


def _joined(one: StereoShadows, other: StereoShadows) -> StereoShadows:
    return StereoShadows(
        width=np.concatenate([one.width, other.width]),
        step=np.concatenate([one.step, other.step]),
        end=np.concatenate([one.end, other.end]),
    )


def _slope(shadows: StereoShadows, fx: float) -> StereoEstimate:
    """Width over focal length times step, without outliers:
    shadows of something that is not in view.
    """
    value = float(np.median(shadows.width / shadows.step)) / fx
    for _ in range(3):
        residual = np.abs(shadows.width - value * fx * shadows.step)
        fits = residual <= max(2.0, 3.0 * 1.4826 * float(np.median(residual)))
        value = float(np.sum(shadows.width[fits]) / (fx * np.sum(shadows.step[fits])))
    mean_width = float(np.mean(shadows.width[fits]))
    spread = 1.4826 * float(np.median(residual[fits])) / (np.sum(fits) / ROWS_ALIKE) ** 0.5
    return stereo_estimate(value, value * float(np.hypot(ROUNDING_PX, spread)) / mean_width)


def left_bands(scene: StaticScene) -> StereoShadows:
    """The band at the left of the sensor: f B / z pixels wide.

    Rows in which it has no end are left out.
    """
    dark = scene.presence <= 0.5
    width = np.argmax(~dark, axis=1)
    beside = np.minimum(width + BESIDE, scene.median.shape[1] - 1)
    step = np.take_along_axis(scene.median, beside[:, None], axis=1)[:, 0]
    # the band of a near object next to it would reach farther: what limits the band is the depth
    # just beside it
    kept = (width >= MIN_WIDTH) & (step > 0.0)
    return StereoShadows(
        width=width.astype(float), step=step.astype(float), end=width.astype(float)
    )[kept]


def edge_shadows(scene: StaticScene) -> StereoShadows:
    """Invalid runs with something near on their right and something far on their left."""
    dark = np.pad(scene.presence <= SELDOM, ((0, 0), (1, 1)))
    change = np.diff(dark.astype(np.int8), axis=1)
    rows, starts = np.nonzero(change == 1)
    _, ends = np.nonzero(change == -1)
    inside = (starts >= BESIDE + 1) & (ends + BESIDE < scene.median.shape[1])
    rows, starts, ends = rows[inside], starts[inside], ends[inside]
    step = scene.median[rows, ends + BESIDE] - scene.median[rows, starts - 1 - BESIDE]
    known = (scene.median[rows, ends + BESIDE] > 0.0) & (
        scene.median[rows, starts - 1 - BESIDE] > 0.0
    )
    width = ends - starts
    nominal = step * scene.fx * BASELINE_M
    # a hole in a pattern-less surface has no reason to be as wide as the step is high: within a
    # factor of 3
    kept = (
        known
        & (width >= MIN_WIDTH)
        & (nominal > MIN_STEP_PX)
        & (width < 3.0 * nominal)
        & (nominal < 3.0 * width)
    )
    return StereoShadows(
        width=width.astype(float), step=step.astype(float), end=ends.astype(float)
    )[kept]
