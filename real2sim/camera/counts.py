"""Rows of a camera's residual that are no depths: spread of noise, holes and copies at edges, lost images."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from real2sim.camera.candidates import FLOOR, CameraEffects
from real2sim.camera.data import AS_CLAIMED, WHOLE, CameraData, owners
from real2sim.camera.edges import EdgeCounts, edge_counts
from real2sim.camera.noise import log_variance
from real2sim.problem import Floats, Indices

RANGES = 4  # parts of the range in which noise is told apart: it grows with the square
FEWEST_DIFFERENCES = 60
USUAL_SPREAD = 0.3  # of the logarithm of noise from camera to camera: plane fits on real frames differ by as much
NOISE_MODEL = 0.1  # of a logarithm of variance: real noise is not exactly z^2
MAX_EDGE_FRAMES, MAX_EDGE_ROWS = 60, 40  # images and rows in which edges are looked for
FEWEST_EDGES = 20
ROUNDING_PX = 0.1  # of the corner: an error of a quarter of what is claimed of an edge
EDGE_MODEL_PX = 0.3  # what a camera without effects may lose or copy at an edge


@dataclass(frozen=True, kw_only=True, eq=False)
class CountRows:
    """Each row: its kind, segment, time, what was measured, its standard deviation, and what it depends on."""

    kind: NDArray[np.int64]
    """0 noise, 1 holes, 2 copies, 3 lost images, 4 what noise is usual; shape (rows,)."""
    segment: Indices
    time_s: Floats
    value: Floats
    sigma: Floats
    range4: Floats
    """Mean fourth power of depth [m^4] of a noise row; 0 for others."""

    def residuals(self, effects: CameraEffects) -> Floats:
        """Measured less expected in units of the standard deviation, shape (rows,)."""
        quadratic = FLOOR**2 * (np.exp(2.0 * effects.floor_level) + effects.noise_variance)
        # a temporal filter of weight alpha leaves alpha / (2 - alpha) of the variance of white noise
        filtered = 1.0 / (1.0 + 2.0 * effects.lag)
        constant = (1e-3 * effects.floor_mm) ** 2 + (1e-3**2) / 12.0
        noise = np.log(filtered * quadratic * np.where(self.range4 > 0.0, self.range4, 1.0) + constant)
        expected = np.choose(
            self.kind, [noise, _left(effects), effects.fill_reach, effects.drop_angle, effects.floor_level]
        )
        return np.asarray((self.value - expected) / self.sigma)


NOISE, HOLES, COPIES, LOST, USUAL = range(5)
Row = tuple[int, int, float, float, float, float]
"""Kind, segment, time, value, standard deviation, range4."""


def _left(effects: CameraEffects) -> float:
    """Width of holes after filling [px]: max(width - reach, 0), rounded off so that a fit finds its way out of 0."""
    width, reach = effects.hole_width, effects.fill_reach
    rest = width - reach
    return 0.5 * (rest + float(np.sqrt(rest**2 + 4.0 * ROUNDING_PX * width * min(reach, 1.0))))


def counted_rows(data: CameraData) -> CountRows:
    """Counts in every segment."""
    noise = _noise_rows(data)
    rows = [*noise, *_edge_rows(data), *_lost_rows(data), *_usual_rows(data, noise)]
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    return CountRows(
        kind=table[:, 0].astype(np.int64),
        segment=table[:, 1].astype(np.int64),
        time_s=table[:, 2],
        value=table[:, 3],
        sigma=table[:, 4],
        range4=table[:, 5],
    )


def _noise_rows(data: CameraData) -> list[Row]:
    depth = data.grid.as_image(data.predicted)[..., 1:-1]
    known = np.isfinite(data.difference)
    if known.sum() < FEWEST_DIFFERENCES:
        return []
    limits = np.quantile(depth[known], np.linspace(0.0, 1.0, RANGES + 1))
    rows = []
    for k in np.unique(data.owner):
        mine = known & (data.owner == k)[:, None, None]
        for low, high in itertools.pairwise(limits.tolist()):
            part = mine & (depth >= low) & (depth <= high)
            if part.sum() < FEWEST_DIFFERENCES:
                continue
            value, deviation = log_variance(data.difference[part], depth[part])
            range4 = float(np.mean(depth[part] ** 4))
            rows.append((NOISE, int(k), _middle_s(data, k), value, float(np.hypot(deviation, NOISE_MODEL)), range4))
    return rows


def _edge_rows(data: CameraData) -> list[Row]:
    looked = np.unique(np.linspace(0, len(data.kept) - 1, MAX_EDGE_FRAMES).astype(np.int64))
    counts = count_edges(data, looked)
    owner = data.owner[looked][counts.frame]
    rows = []
    for k in np.unique(owner):
        mine = owner == k
        if mine.sum() < FEWEST_EDGES:
            continue
        for kind, values in ((HOLES, counts.holes), (COPIES, counts.copies)):
            # edges of one image lose their pixels together
            images = [np.mean(values[mine & (counts.frame == f)]) for f in np.unique(counts.frame[mine])]
            deviation = float(np.std(images) / np.sqrt(len(images)))
            sigma = float(np.hypot(deviation, EDGE_MODEL_PX))
            rows.append((kind, int(k), _middle_s(data, k), float(np.mean(images)), sigma, 0.0))
    return rows


def count_edges(data: CameraData, looked: NDArray[np.int64]) -> EdgeCounts:
    """Counts at edges of the frames `looked`, places in `data.kept`."""
    height, width = data.images_mm.shape[1:]
    row = np.unique(np.linspace(0, height - 1, MAX_EDGE_ROWS).astype(np.int64))
    grid = np.meshgrid(row, np.arange(width, dtype=np.int64), indexing="ij")
    model = replace(data.model, tangents=data.camera.tangents(grid[0].ravel(), grid[1].ravel()))
    predicted = model.predict(AS_CLAIMED, data.kept[looked]).reshape(len(looked), len(row), width)
    return edge_counts(predicted, data.images_mm[np.ix_(looked, row)], WHOLE * data.camera.range_m)


def _lost_rows(data: CameraData) -> list[Row]:
    owner = owners(data.frames.due_s, data.segments)
    rows = []
    for k in np.unique(owner[owner >= 0]):
        lost = data.frames.lost[owner == k]
        # the arc sine of the root of a share has the variance 1 / 4n whatever the share
        angle = float(np.arcsin(np.sqrt(lost.mean())))
        rows.append((LOST, int(k), _middle_s(data, k), angle, 0.5 / np.sqrt(len(lost)), 0.0))
    return rows


def _usual_rows(data: CameraData, noise: list[Row]) -> list[Row]:
    """What is known of cameras without a log: without it, noise that is added looks like a camera that has more."""
    owners_of = sorted({row[1] for row in noise})
    sigma = USUAL_SPREAD * np.sqrt(len(owners_of))
    return [(USUAL, k, _middle_s(data, k), 0.0, float(sigma), 0.0) for k in owners_of]


def _middle_s(data: CameraData, segment: int) -> float:
    return 0.5 * (data.segments[segment].start_s + data.segments[segment].end_s)
