"""Pixels that read the end of the range: often few,
in a crease between floor and wall or at the border of images.
"""

from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.camera.candidates import CameraEffects
from saltus.real2sim.problem.camera.data import CameraData
from saltus.real2sim.problem.camera.model import DepthModel

PIXELS = 60  # at most: a quarter of those that are compared elsewhere
# Of the end by which neighbours may be nearer: floor at 2 m changes by half of it from pixel to
# pixel
BESIDE = 0.15
JUMP = 0.04  # of depth: more than the slope beside it, from pixel to pixel, is an edge


@dataclass(frozen=True, kw_only=True, eq=False)
class EndOfRange:
    """Samples of pixels that have the largest depth of a log, beside what is predicted there.

    All that is known of them is that they read the end: that the scene goes on behind it is what
    speaks for a clip.
    """

    model: DepthModel
    kept: Indices
    end_m: float
    sigma_m: float
    """Noise just below the end."""
    at: tuple[Indices, Indices]
    """Places in `kept` and among the pixels of the model, each of shape (samples,)."""

    def residuals(self, effects: CameraEffects) -> Floats:
        """Measured less predicted in units of noise, shape (samples,)."""
        return np.asarray(
            (self.end_m - self.model.predict(effects, self.kept)[self.at]) / self.sigma_m
        )


def end_of_range(data: CameraData) -> EndOfRange | None:
    """The samples of a log whose depth ends early; None where it does not, or only beside edges."""
    if data.clip_m is None:
        return None
    end_mm = round(1e3 * data.clip_m)
    is_end = data.images_mm == end_mm
    often = is_end.sum(axis=0).ravel()
    best = np.argsort(-often, kind="stable")[: np.count_nonzero(often)]
    best = np.sort(best[np.unique(np.linspace(0, len(best) - 1, PIXELS).astype(np.int64))])
    row, column = np.unravel_index(best, is_end.shape[1:])
    is_chosen = is_end[:, row, column]
    for rows, columns in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        is_chosen &= _beside(data, row + rows, column + columns) >= (1.0 - BESIDE) * end_mm
    is_chosen &= ~_near_jump(data, row, column)
    if not is_chosen.any():
        return None
    frame, pixel = np.nonzero(is_chosen)
    return EndOfRange(
        model=replace(data.model, tangents=data.camera.tangents(row, column), is_hole=None),
        kept=data.kept,
        end_m=data.clip_m,
        sigma_m=float(data.noise.sigma(np.array(data.clip_m))),
        at=(frame, pixel),
    )


def _beside(data: CameraData, row: Indices, column: Indices) -> Floats:
    """Measured depth [mm] of pixels, infinite where invalid or outside, shape (kept, pixels)."""
    height, width = data.images_mm.shape[1:]
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    values = data.images_mm[:, np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)].astype(
        np.float64
    )
    return np.where(inside & (values > 0.0), values, np.inf)


def _near_jump(data: CameraData, row: Indices, column: Indices) -> np.ndarray:
    """True where the predicted scene jumps within the margin; a crease is no jump.

    Shape (kept, pixels).
    """
    reach = data.grid.margin + 1
    broken = np.zeros((len(data.kept), len(row)), dtype=bool)
    for rows, columns in ((0, 1), (1, 0)):
        line = []
        for k in range(-reach, reach + 1):
            tangents = data.camera.tangents(row + k * rows, column + k * columns)
            line.append(replace(data.model, tangents=tangents).predict(data.view, data.kept))
        slope = np.diff(np.log(np.stack(line)), axis=0)
        here = slope[1:-1]
        for other in (slope[:-2], slope[2:]):  # a slope is like its neighbour on one side at least
            here = np.where(
                np.sign(here) == np.sign(other),
                np.sign(here) * np.maximum(np.abs(here) - np.abs(other), 0.0),
                here,
            )
        broken |= np.any(np.abs(here) > JUMP, axis=0)
    return broken
