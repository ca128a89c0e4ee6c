"""Pixels that are lost or fly beside depth edges, and columns that are invalid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.render.stereo.edges import StereoEdgeHoles
from saltus.render.stereo.static_scene import (
    StaticScene,
    StereoEstimate,
    stereo_estimate,
    untestable_estimate,
)

MIN_STEP_PX = 2.0  # of nominal disparity: an edge
SAME_PX = 1.0  # of nominal disparity: one surface
NEAR_SIDE, FAR_SIDE = 5, 12  # pixels that are looked at on both sides
REACH_PX = 5  # whole pixels that the reach of the holes touches
MIN_EDGES = 20
FLYING_SIGMAS = 6.0


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeCurves:
    """Share of invalid pixels against their distance from depth edges, in a recording."""

    column: Floats
    """Share of the frames and rows in which each column is invalid, shape (width,)."""
    distance_px: Floats
    """From right edges of near things: positive on the far side, shape (n,)."""
    invalid: Floats
    """Share at these distances; not a number where no edge is in view."""
    edges: int
    """Number of edges, one a row."""


def edge_curves(scene: StaticScene) -> EdgeCurves:
    """Measures where pixels are invalid."""
    rows, columns = _right_edges(scene)
    distance = np.arange(-NEAR_SIDE, FAR_SIDE + 1)
    distance = distance[distance != 0]
    # distance 1 is the first pixel of the far side, -1 the last of the near side
    offset = np.where(distance > 0, distance - 1, distance)
    invalid = (
        1.0 - np.mean(scene.presence[rows[:, None], columns[:, None] + offset], axis=0)
        if len(rows)
        else np.full(len(distance), np.nan)
    )
    return EdgeCurves(
        column=1.0 - np.mean(scene.presence, axis=0),
        distance_px=distance,
        invalid=invalid,
        edges=len(rows),
    )


def hole_fraction(curves: EdgeCurves) -> StereoEstimate:
    """Share of pixels that is lost within the reach of `StereoEdgeHoles`,
    on the side that has no shadow.
    """
    if curves.edges < MIN_EDGES:
        return untestable_estimate(
            f"{curves.edges} rows with a clean right edge of something near: {MIN_EDGES} are needed"
        )
    inside = (curves.distance_px > 0) & (curves.distance_px <= REACH_PX)
    background = float(np.mean(curves.invalid[curves.distance_px > 2 * REACH_PX]))
    value = float(np.mean(curves.invalid[inside])) - background
    # pixels that are touched in part stand for fewer: see EdgeHoles
    value *= REACH_PX / StereoEdgeHoles().reach
    return stereo_estimate(
        max(0.0, value), float(np.sqrt(max(value * (1.0 - value), 1e-4) / curves.edges))
    )


def flying_fraction(scene: StaticScene, sigma_inverse: float) -> StereoEstimate:
    """Share of the pixels beside an edge that lie between both sides."""
    rows, columns = _right_edges(scene)
    if len(rows) < MIN_EDGES:
        return untestable_estimate(
            f"{len(rows)} rows with a clean right edge of something near: {MIN_EDGES} are needed"
        )
    near, far = scene.median[rows, columns - 2], scene.median[rows, columns + 1]
    flying, seen = 0, 0
    for column in (columns - 1, columns):
        values = scene.inverse[:, rows, column]
        valid = values > 0.0
        between = (values > far + FLYING_SIGMAS * sigma_inverse) & (
            values < near - FLYING_SIGMAS * sigma_inverse
        )
        flying += int(np.sum(valid & between))
        seen += int(np.sum(valid))
    lost_at_ends = np.mean(np.clip(2.0 * FLYING_SIGMAS * sigma_inverse / (near - far), 0.0, 0.9))
    value = flying / max(seen, 1) / (1.0 - float(lost_at_ends))
    return stereo_estimate(value, float(np.sqrt(max(value, 1e-3) / max(seen, 1))))


def _right_edges(scene: StaticScene) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and first columns of the far side where something near ends before one far surface."""
    width = scene.median.shape[1]
    nominal = np.where(scene.presence > 0.2, scene.nominal, np.nan)
    rows, columns = np.nonzero(nominal[:, :-1] - nominal[:, 1:] > MIN_STEP_PX)
    columns = columns + 1
    inside = (columns >= NEAR_SIDE + 1) & (columns + FAR_SIDE <= width)
    rows, columns = rows[inside], columns[inside]
    far = nominal[rows[:, None], columns[:, None] + np.arange(FAR_SIDE)]
    near = nominal[rows[:, None], columns[:, None] - 1 - np.arange(NEAR_SIDE)]
    one_surface = np.all(np.abs(np.diff(far, axis=1)) < SAME_PX, axis=1) & np.all(
        np.abs(np.diff(near, axis=1)) < SAME_PX, axis=1
    )
    return rows[one_surface], columns[one_surface]
