"""Baseline from what the right imager misses: the band at the left of the image and the shadows of near things."""

from dataclasses import dataclass

import numpy as np

from render.stereo.estimate import Estimate, measured, untestable
from render.stereo.optics import BASELINE_M
from render.stereo.static_scene import StaticScene
from saltus.messages import Floats

SELDOM = 0.05  # a shadow is invalid in every frame; noise at its border lets some through
MIN_WIDTH = 3  # px: narrower ones may be holes at edges
MIN_STEP_PX = 2.0  # of nominal disparity across a shadow
MIN_ROWS = 10
ROUNDING_PX = 0.29  # standard deviation of a width in whole pixels, the same in all rows of an upright edge
BESIDE = 2  # pixels from the border of a shadow at which depth is read: clear of flying pixels


@dataclass(frozen=True, kw_only=True, eq=False)
class Shadows:
    """Runs of invalid pixels in rows that the geometry of stereo explains."""

    width: Floats
    """[px], shape (n,)."""
    step: Floats
    """Difference of inverse depth between its sides [1/m]; inverse depth itself for the left band. Shape (n,)."""


def fit_baseline(scene: StaticScene) -> Estimate:
    """Baseline [m]: width over focal length times step, over all shadows and the band."""
    bands, shadows = left_bands(scene), edge_shadows(scene)
    width = np.concatenate([bands.width, shadows.width])
    step = np.concatenate([bands.step, shadows.step])
    if len(width) < MIN_ROWS:
        return untestable("no invalid band at the left of the image and no shadow beside a near edge")
    value = float(np.sum(width) / (scene.fx * np.sum(step)))
    # least absolute deviation from it tells the outliers: shadows of something that is not in view
    residual = width - value * scene.fx * step
    fits = np.abs(residual) <= max(2.0, 3.0 * 1.4826 * float(np.median(np.abs(residual))))
    value = float(np.sum(width[fits]) / (scene.fx * np.sum(step[fits])))
    return measured(value, value * ROUNDING_PX / float(np.mean(width[fits])))


def left_bands(scene: StaticScene) -> Shadows:
    """The band at the left of the sensor: f B / z pixels wide. Rows in which it has no end are left out."""
    dark = scene.presence <= 0.5
    width = np.argmax(~dark, axis=1)
    beside = np.minimum(width + BESIDE, scene.median.shape[1] - 1)
    step = np.take_along_axis(scene.median, beside[:, None], axis=1)[:, 0]
    # the band of a near object next to it would reach farther: what limits the band is the depth just beside it
    kept = (width >= MIN_WIDTH) & (step > 0.0)
    return Shadows(width=width[kept].astype(float), step=step[kept].astype(float))


def edge_shadows(scene: StaticScene) -> Shadows:
    """Invalid runs with something near on their right and something far on their left."""
    dark = np.pad(scene.presence <= SELDOM, ((0, 0), (1, 1)))
    change = np.diff(dark.astype(np.int8), axis=1)
    rows, starts = np.nonzero(change == 1)
    _, ends = np.nonzero(change == -1)
    inside = (starts >= BESIDE + 1) & (ends + BESIDE < scene.median.shape[1])
    rows, starts, ends = rows[inside], starts[inside], ends[inside]
    step = scene.median[rows, ends + BESIDE] - scene.median[rows, starts - 1 - BESIDE]
    known = (scene.median[rows, ends + BESIDE] > 0.0) & (scene.median[rows, starts - 1 - BESIDE] > 0.0)
    width = ends - starts
    nominal = step * scene.fx * BASELINE_M
    # a hole in a pattern-less surface has no reason to be as wide as the step is high: within a factor of 3
    kept = known & (width >= MIN_WIDTH) & (nominal > MIN_STEP_PX) & (width < 3.0 * nominal) & (nominal < 3.0 * width)
    return Shadows(width=width[kept].astype(float), step=step[kept].astype(float))
