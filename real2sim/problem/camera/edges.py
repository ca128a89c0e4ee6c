"""Invalid and copied pixels, which no mean of depth shows:
to the left of near objects, and away from edges.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Indices

# Px to the left of an edge in which holes and copies are counted: more than a matching window loses
WINDOW = 12
PAST_EDGE = 2  # px: where an edge is, is known to about a pixel
JUMP = 0.08  # of the depth behind; a smaller step is bridged by a matching window
MOST_HOLES = 0.3  # usual share: behind such edges nothing can be told
AMBIENT = 3  # px at least, beyond the window, from which the usual share is known
FEWEST = 50  # pairs of neighbours: how often, and by how much, they differ is then known
BELOW_MM = 10.0  # several times the noise of a pixel
# Of depth from pixel to pixel: on a slope, neighbours are equal by chance less often
SLOPES_MM = (
    0.5,
    1.5,
    3.0,
    6.0,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeCounts:
    """Counts at left edges of near objects, less what is usual elsewhere in the same rows."""

    frame: Indices
    """Place of the image among those looked at, shape (edges,)."""
    holes: Floats
    """Invalid pixels [px], shape (edges,)."""
    copies: Floats
    """Pixels that are exactly as their left neighbour [px], shape (edges,)."""
    by_chance: Floats
    """Usual part of those, which is taken off [px], shape (edges,)."""


def edge_counts(
    predicted_m: Floats, measured_mm: NDArray[np.uint16], range_m: float, clip_mm: float = np.inf
) -> EdgeCounts:
    """Counts in the rows of images, shape (images, rows, columns),
    where nothing is beyond the claimed `range_m`.

    Depth is predicted without effects. What is farther than `clip_mm` reads as that: such
    neighbours are equal, and no copies.
    """
    seen_m = np.minimum(predicted_m, 1e-3 * clip_mm)
    edge = seen_m[..., 1:] < (1.0 - JUMP) * seen_m[..., :-1]
    frame, row, column = np.nonzero(edge)
    column = column + 1  # the first pixel of the near object
    first, last = column - WINDOW, column + PAST_EDGE
    keep = (first >= AMBIENT) & (last <= measured_mm.shape[2])
    frame, row, column, first, last = (a[keep] for a in (frame, row, column, first, last))
    start = np.maximum(first - WINDOW, 0)
    keep = _count(edge, frame, row, start, last - 1) == 1
    keep &= _count(predicted_m >= range_m, frame, row, start, last) == 0
    frame, row, column, first, last, start = (
        a[keep] for a in (frame, row, column, first, last, start)
    )
    if not frame.size:
        return EdgeCounts(frame=frame, holes=np.empty(0), copies=np.empty(0), by_chance=np.empty(0))
    hole = measured_mm == 0
    holes = _count(hole, frame, row, first, last)
    usual_holes = float(np.sum(_count(hole, frame, row, start, first)) / np.sum(first - start))
    if usual_holes > MOST_HOLES:
        return EdgeCounts(frame=frame[:0], holes=holes[:0], copies=holes[:0], by_chance=holes[:0])
    copies, by_chance, pairs = np.zeros((3, len(frame)))
    beyond = np.minimum(last + WINDOW // 2, measured_mm.shape[2])
    for is_pair, is_copy in _by_slope(seen_m, measured_mm, clip_mm):
        # what is near has noise of its own
        sides = ((first, column, start, first), (column, last, last, beyond))
        usual = [
            [float(_count(marked, frame, row, *side[2:]).sum()) for side in sides]
            for marked in (is_pair, is_copy)
        ]
        for side, usual_pairs, equal in zip(sides, *usual, strict=True):
            if usual_pairs < FEWEST:  # a rate of one pair would hold for thousands
                usual_pairs, equal = sum(usual[0]), sum(usual[1])
            if usual_pairs < FEWEST:
                continue
            here = _count(is_pair, frame, row, *side[:2])
            copies += _count(is_copy, frame, row, *side[:2])
            by_chance += equal / usual_pairs * here
            pairs += here
    usual_copies = float(by_chance.sum() / max(pairs.sum(), 1.0))
    # a pixel that the edge has taken is not lost or copied once more by the usual chance
    return EdgeCounts(
        frame=frame,
        holes=(holes - usual_holes * (last - first)) / max(1.0 - usual_holes, 0.1),
        copies=(copies - by_chance) / max(1.0 - usual_copies, 0.1),
        by_chance=by_chance,
    )


def _by_slope(
    depth_m: Floats, measured_mm: NDArray[np.uint16], clip_mm: float
) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
    """For each class of slopes: valid pixels with a valid left neighbour,
    and those of them that are equal to it.
    """
    # an end of the range takes noise away from what is just below it, too
    whole = (measured_mm > 0) & (measured_mm < clip_mm) & (1e3 * depth_m < clip_mm - BELOW_MM)
    pair = whole[..., 1:] & whole[..., :-1]
    copy = pair & (measured_mm[..., 1:] == measured_mm[..., :-1])
    with np.errstate(invalid="ignore"):  # where nothing is seen
        slope_mm = np.nan_to_num(1e3 * np.abs(np.diff(depth_m)), nan=np.inf)
    kind = np.searchsorted(SLOPES_MM, slope_mm)
    for k in range(len(SLOPES_MM) + 1):
        yield _beside_border(pair & (kind == k)), _beside_border(copy & (kind == k))


def _beside_border(marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """With a first column, which has no left neighbour."""
    return np.pad(marked, ((0, 0), (0, 0), (1, 0)))


def _count(
    marked: NDArray[np.bool_],
    frame: Indices,
    row: Indices,
    first: Indices,
    last: Indices,
) -> Floats:
    """Marked pixels in the columns [first, last) of rows, shape (n,)."""
    total = np.cumsum(np.pad(marked, ((0, 0), (0, 0), (1, 0))), axis=2)
    return np.asarray(total[frame, row, last] - total[frame, row, first], dtype=np.float64)


AROUND_PX = 3  # from an edge of either side: a camera mixes the pixels there
BROKEN = 0.04  # of depth, from pixel to pixel: an edge
DEPTHS = 6  # parts of the depth: each has noise of its own
# Standard deviations from which copies are more than chance, where there are no holes beside them
SURE = 4.0
FEW_HOLES = 3.0  # that stay: fewer say at least how far a filter reaches
SHAPE = {1: 1.5, 2: -0.6, 3: 0.1}
"""Weights that interpolate to 0: of the logarithm of how often neighbours differ by so many mm,
mean of both signs."""


@dataclass(frozen=True, kw_only=True)
class FilledShare:
    """Share of the pixels away from edges that are copies, and how sure that is."""

    share: float
    deviation: float


def plain_pixels(
    predicted_m: Floats, measured_mm: NDArray[np.uint16], range_m: float
) -> NDArray[np.bool_]:
    """Pixels away from edges, with something in range to see
    and a valid pixel somewhere to their left.

    Args:
        predicted_m: depth without effects, shape (images, rows, columns).
        measured_mm: shape as `predicted_m`.
        range_m: claimed end of the range.
    """
    with np.errstate(invalid="ignore"):
        step = np.abs(np.diff(predicted_m)) / predicted_m[..., 1:]
    near = np.zeros(predicted_m.shape, dtype=bool)
    jump = ~(step < BROKEN)
    left = predicted_m[..., 1:] < (1.0 - BROKEN) * predicted_m[..., :-1]
    width = predicted_m.shape[-1]
    for k in range(-WINDOW, AROUND_PX + 1):
        marked = jump if abs(k) <= AROUND_PX else left
        first, last = max(1 + k, 0), min(width + k, width)  # a jump stands at the pixel right of it
        near[..., first:last] |= marked[..., first - 1 - k : last - 1 - k]
    reached = np.logical_or.accumulate(measured_mm > 0, axis=-1)
    return np.asarray(~near & reached & (predicted_m < range_m))


def filled_share(
    predicted_m: Floats, measured_mm: NDArray[np.uint16], plain: NDArray[np.bool_], clip_mm: float
) -> FilledShare | None:
    """The share of copies among plain pixels;
    None where noise is too small or pixels are too few to tell.

    Noise that is smooth in depth makes equal neighbours about as often as neighbours that differ by
    1 mm. Noise that is smooth in the image makes neighbours alike that are 2 px apart as well.
    Copies do neither: the smaller of the two excesses counts.
    """
    whole = (
        plain
        & (measured_mm > 0)
        & (measured_mm < clip_mm)
        & (1e3 * predicted_m < clip_mm - BELOW_MM)
    )
    if not whole.any():
        return None
    values = measured_mm.astype(np.int32)
    limits = np.quantile(
        predicted_m[whole][:: max(1, int(whole.sum()) // 20_000)],
        np.linspace(0.0, 1.0, DEPTHS + 1)[1:-1],
    )
    part = np.searchsorted(limits, predicted_m)
    next_to, apart = (_differences(values, whole, part, step) for step in (1, 2))
    found = np.array([_excess(one, two) for one, two in zip(next_to, apart, strict=True)])
    found = found[np.isfinite(found[:, 0])]
    if not len(found):
        return None
    by_shape, by_distance, pairs, shape_variance, distance_variance = found.sum(axis=0)
    return FilledShare(
        share=float(min(by_shape, by_distance) / pairs),
        deviation=float(math.sqrt(max(shape_variance, distance_variance)) / pairs),
    )


def reach_px(holes: float, pixels: float, unfilled: float) -> float:
    """How far a filter reaches that leaves so many holes,
    where a share `unfilled` of the pixels was lost one by one.

    A hole whose next k - 1 pixels to the left are holes is filled where the reach is k; a share of
    those where it lies between k - 1 and k.
    """
    left = max(holes, 0.5) / (pixels * unfilled)
    whole = max(0, math.floor(math.log(left) / math.log(unfilled)))
    return whole + (1.0 - left / unfilled**whole) / (1.0 - unfilled)


def _differences(
    values: NDArray[np.int32], whole: NDArray[np.bool_], part: Indices, step: int
) -> Floats:
    """How often pixels `step` apart differ by -3 to 3 mm,
    and how many pairs there are, shape (parts, 8).
    """
    pair = whole[..., step:] & whole[..., :-step]
    difference = (values[..., step:] - values[..., :-step])[pair]
    code = part[..., step:][pair] * 8 + np.where(np.abs(difference) <= 3, difference + 3, 7)
    counts = np.bincount(code, minlength=8 * DEPTHS).reshape(DEPTHS, 8).astype(np.float64)
    counts[:, 7] = counts.sum(axis=1)
    return counts


def _excess(next_to: Floats, apart: Floats) -> tuple[float, float, float, float, float]:
    """Equal neighbours that noise does not make, by shape and by distance; all pairs.

    Variances of the two.

    NaN where noise does not have the shape that is assumed.
    """
    sides = {d: (next_to[3 - d], next_to[3 + d]) for d in SHAPE}
    # Else depth comes in steps, and noise is not smooth in it
    falls = sum(sides[1]) >= sum(sides[2]) >= sum(sides[3])
    if not falls or min(min(side) for side in sides.values()) < FEWEST or apart[7] < FEWEST:
        return (math.nan,) * 5
    equal, pairs = float(next_to[3]), float(next_to[7])
    logarithm = sum(
        weight * 0.5 * math.log(sides[d][0] * sides[d][1]) for d, weight in SHAPE.items()
    )
    variance = sum(
        (0.5 * weight) ** 2 * (1.0 / sides[d][0] + 1.0 / sides[d][1]) for d, weight in SHAPE.items()
    )
    by_chance, ratio = math.exp(logarithm), pairs / float(apart[7])
    far = float(apart[3]) * ratio
    unlike = 1.0 - far / pairs  # a copy takes the place of a pixel that may be equal by chance
    by_distance = (equal - far) / unlike
    return (
        equal - by_chance,
        by_distance,
        pairs,
        equal + by_chance**2 * variance,
        (equal + far * ratio) / unlike**2,
    )
