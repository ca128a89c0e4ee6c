"""Rows of a camera's residual that are no depths:
spread of noise, holes and copies at edges, lost images.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import rel_entr

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.camera.candidates import FLOOR, CameraEffects
from saltus.real2sim.problem.camera.depth_model import WHOLE
from saltus.real2sim.problem.camera.edges import (
    FEW_HOLES,
    MOST_HOLES,
    SURE,
    edge_counts,
    filled_share,
    plain_pixels,
    reach_px,
)
from saltus.real2sim.problem.camera.log_images import CameraData, segment_indices
from saltus.real2sim.problem.camera.noise_parts import NoiseParts, noise_parts

# Of the logarithm of noise from camera to camera: plane fits on real frames differ by as much
USUAL_SPREAD = 0.3
QUIET_SPREAD = (
    3.0  # the same where there is less: pooled or filtered images are quieter by any factor
)
USUAL_LOSS = 1e-3  # of the images: what a camera without effects may lose
NOISE_MODEL = 0.1  # of a logarithm of variance: real noise is not exactly z^2
# Images and rows in which edges and copies are looked for
MAX_DENSE_FRAMES, MAX_DENSE_ROWS = (
    300,
    40,
)
FEWEST_EDGES = 20
ROUNDING_PX = 0.1  # of the corner: an error of a quarter of what is claimed of an edge
FEWEST_LOST = 20.0  # pixels that a segment would lose without a filter
# Rounding to 1 mm alone has 2.9e-4: then the scene makes equal neighbours, and noise does not
LEAST_NOISE_M = 5e-4
AT_LEAST_PX = 2.0  # of a reach that leaves next to no hole
BLOCKS = 5  # of images: each longer than a temporal filter remembers
CHANCE_MODEL = 0.2  # of the copies that are usual
EDGE_MODEL_PX = 0.3  # what a camera without effects may lose or copy at an edge


NOISE, HOLES, COPIES, LOST, USUAL, FILLED, PATTERN = range(7)
CountRow = tuple[int, int, float, float, float, float, float]
"""Kind, segment, time, value, standard deviation, the same where more is expected, argument."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CountRows:
    """Counts of invalid or copied pixels, a row each: its kind, segment, time, what was measured,
    its standard deviation, and what it depends on.
    """

    kind: Indices
    """0 noise, 1 holes, 2 copies, 3 lost images, 4 what noise is usual, 5 filled holes, 6 what
    repeats in the noise; shape (rows,)."""
    segment: Indices
    time_s: Floats
    value: Floats
    """Measured value; of noise, beside what is predicted without effects."""
    sigma: Floats
    sigma_above: Floats
    """Standard deviation where more is expected than was measured."""
    argument: Floats
    """Mean fourth power of depth [m^4] of a noise row; images that were due of a row of lost ones;
    0 for others."""
    noise: NoiseParts

    def residuals(self, effects: CameraEffects, predicted: Floats, noise_share: Floats) -> Floats:
        """Measured less expected in units of the standard deviation, shape (rows,).

        `predicted` is the depth with the effects at the pixels of the grid [m], `noise_share` the
        share of the variance of noise that they leave there, both of shape (kept, pixels).
        """
        quadratic = FLOOR**2 * (np.exp(2.0 * effects.noise_floor_level) + effects.depth_noise)
        filtered = self.noise.means(noise_share)
        constant = (1e-3 * np.exp(effects.noise_floor_constant)) ** 2
        left = _left(effects)
        expected = np.choose(
            self.kind,
            [
                0.0,
                left,
                effects.edge_holes - left,
                0.0,
                effects.noise_floor_level,
                effects.hole_fill,
                0.0,
            ],
        )
        value = self.value.copy()
        is_noise, is_lost = self.kind == NOISE, self.kind == LOST
        expected[is_noise] = np.log(
            filtered * (quadratic * self.argument[is_noise] + constant) + (1e-3**2) / 12.0
        )
        # no effect repeats itself from image to image, or along a column
        value[self.kind == PATTERN] = repeating = self.noise.log_repeating(predicted)
        value[is_noise] = self.noise.log_variances(predicted) - repeating
        residual = (value - expected) / np.where(expected > value, self.sigma_above, self.sigma)
        residual[is_lost] = _signed_deviance(
            self.value[is_lost], self.argument[is_lost], effects.frame_drop
        )
        return np.asarray(residual)


def _signed_deviance(share: Floats, due: Floats, angle: float) -> Floats:
    """Signed square roots of the deviance of shares of lost images:
    few are far from a bell curve.
    """
    expected = USUAL_LOSS + (1.0 - USUAL_LOSS) * math.sin(angle) ** 2
    deviance = rel_entr(share, expected) + rel_entr(1.0 - share, 1.0 - expected)
    return np.asarray(np.sign(share - expected) * np.sqrt(2.0 * due * np.maximum(deviance, 0.0)))


def _left(effects: CameraEffects) -> float:
    """Width of holes after filling [px]: max(width - reach, 0),
    rounded off so that a fit finds its way out of 0.
    """
    width, reach = effects.edge_holes, effects.hole_fill
    rest = width - reach
    return 0.5 * (rest + float(np.sqrt(rest**2 + 4.0 * ROUNDING_PX * width * min(reach, 1.0))))


def counted_rows(data: CameraData) -> CountRows:
    """Counts in every segment."""
    noise, view = noise_parts(data), _dense_view(data)
    rows = [
        *_noise_rows(data, noise),
        *_edge_rows(data, view),
        *_lost_rows(data),
        *_usual_rows(data, noise),
        *_filled_rows(data, view),
    ]
    table = np.array(rows, dtype=np.float64).reshape(-1, 7)
    return CountRows(
        kind=table[:, 0].astype(np.int64),
        segment=table[:, 1].astype(np.int64),
        time_s=table[:, 2],
        value=table[:, 3],
        sigma=table[:, 4],
        sigma_above=table[:, 5],
        argument=table[:, 6],
        noise=noise,
    )


def _noise_rows(data: CameraData, noise: NoiseParts) -> list[CountRow]:
    """Two rows for each part: its noise, and by how much structure
    that repeats would make it look larger.
    """
    repeating = noise.log_repeating(data.predicted)
    values = noise.log_variances(data.predicted) - repeating
    sigma = np.hypot(noise.deviation, NOISE_MODEL)
    rows = []
    for k, *found, s, range4 in zip(
        noise.segment, values, repeating, sigma, noise.range4, strict=True
    ):
        for kind, value, argument in zip((NOISE, PATTERN), found, (range4, 0.0), strict=True):
            rows.append(
                (
                    kind,
                    int(k),
                    _middle_s(data, k),
                    float(value),
                    float(s),
                    float(s),
                    float(argument),
                )
            )
    return rows


@dataclass(frozen=True, kw_only=True, eq=False)
class WholeRows:
    """Whole rows of images beside what is predicted of them without effects,
    shape (images, rows, columns).
    """

    owner: Indices
    """Segment of each image."""
    predicted_m: Floats
    measured_mm: NDArray[np.uint16]
    range_m: float
    """Depth that lies safely within the claimed range."""
    clip_mm: float
    """Value at which depth ends early; infinite where it does not."""


def _dense_view(data: CameraData) -> WholeRows:
    looked = np.unique(np.linspace(0, len(data.kept) - 1, MAX_DENSE_FRAMES).astype(np.int64))
    height, width = data.images_mm.shape[1:]
    row = np.unique(np.linspace(0, height - 1, MAX_DENSE_ROWS).astype(np.int64))
    grid = np.meshgrid(row, np.arange(width, dtype=np.int64), indexing="ij")
    model = replace(data.model, tangents=data.camera.tangents(grid[0].ravel(), grid[1].ravel()))
    return WholeRows(
        owner=data.owner[looked],
        predicted_m=model.predict(data.view, data.kept[looked]).reshape(
            len(looked), len(row), width
        ),
        measured_mm=data.images_mm[np.ix_(looked, row)],
        range_m=WHOLE * data.camera.range_m,
        clip_mm=np.inf if data.clip_m is None else 1e3 * data.clip_m,
    )


def _edge_rows(data: CameraData, view: WholeRows) -> list[CountRow]:
    counts = edge_counts(view.predicted_m, view.measured_mm, view.range_m, view.clip_mm)
    owner = view.owner[counts.frame]
    rows = []
    for k in np.unique(owner):
        mine = owner == k
        if mine.sum() < FEWEST_EDGES:
            continue
        for kind, values in ((HOLES, counts.holes), (COPIES, counts.copies)):
            # edges of one image lose their pixels together
            images = [
                np.mean(values[mine & (counts.frame == f)]) for f in np.unique(counts.frame[mine])
            ]
            sigma = float(np.hypot(_deviation_of_mean(images), EDGE_MODEL_PX))
            # a ghost of an edge takes away what is usual there: fewer copies than that are no
            # effect
            above = (
                sigma
                if kind == HOLES
                else float(np.hypot(sigma, CHANCE_MODEL * np.mean(counts.by_chance[mine])))
            )
            rows.append(
                (kind, int(k), _middle_s(data, k), float(np.mean(images)), sigma, above, 0.0)
            )
    return rows


def _deviation_of_mean(images: list[np.floating]) -> float:
    """Deviation of the mean of counts of one image after the other,
    which a temporal filter makes alike.
    """
    blocks = [np.mean(block) for block in np.array_split(images, min(BLOCKS, len(images)))]
    return float(max(np.std(part) / np.sqrt(len(part)) for part in (images, blocks)))


def _filled_rows(data: CameraData, view: WholeRows) -> list[CountRow]:
    """How far holes away from edges are filled:
    the share that would be lost is that of the whole log.
    """
    noise_m = data.noise.sigma(data.predicted)[data.known]
    if not noise_m.size or float(np.median(noise_m)) < LEAST_NOISE_M:
        return []
    plain = plain_pixels(view.predicted_m, view.measured_mm, view.range_m)
    copies = filled_share(view.predicted_m, view.measured_mm, plain, view.clip_mm)
    hole = plain & (view.measured_mm == 0)
    if copies is None or not plain.any():
        return []
    share = float(hole.sum() / plain.sum())
    unfilled = share + copies.share
    if unfilled < SURE * copies.deviation or not 0.0 < unfilled < MOST_HOLES:
        return []
    rows = []
    owners_of = np.unique(view.owner)
    for k in owners_of:
        mine = view.owner == k
        pixels, holes = float(plain[mine].sum()), float(hole[mine].sum())
        if pixels * unfilled < FEWEST_LOST:
            continue
        # all segments share one estimate of the copies
        deviation = share / unfilled**2 * copies.deviation * np.sqrt(len(owners_of))
        by_chance = 1.0 / np.sqrt(holes + 0.5) / -np.log(unfilled)
        sigma = float(np.sqrt(deviation**2 + by_chance**2 + EDGE_MODEL_PX**2))
        above = AT_LEAST_PX if holes < FEW_HOLES else sigma
        rows.append(
            (
                FILLED,
                int(k),
                _middle_s(data, k),
                reach_px(holes, pixels, unfilled),
                sigma,
                above,
                0.0,
            )
        )
    return rows


def _lost_rows(data: CameraData) -> list[CountRow]:
    owner = segment_indices(data.frames.due_s, data.segments)
    rows = []
    for k in np.unique(owner[owner >= 0]):
        lost = data.frames.lost[owner == k]
        rows.append(
            (LOST, int(k), _middle_s(data, k), float(lost.mean()), 1.0, 1.0, float(len(lost)))
        )
    return rows


def _usual_rows(data: CameraData, noise: NoiseParts) -> list[CountRow]:
    """Rows known of cameras without a log.

    Without them, added noise looks like a camera that has more.
    """
    owners_of = np.unique(noise.segment)
    less, more = (
        spread * float(np.sqrt(len(owners_of))) for spread in (QUIET_SPREAD, USUAL_SPREAD)
    )
    return [(USUAL, int(k), _middle_s(data, k), 0.0, less, more, 0.0) for k in owners_of]


def _middle_s(data: CameraData, segment: int) -> float:
    return 0.5 * (data.segments[segment].start_s + data.segments[segment].end_s)
