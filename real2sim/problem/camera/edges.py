"""Invalid and copied pixels to the left of near objects: what no mean of depth shows."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Indices

WINDOW = 12  # px to the left of an edge in which holes and copies are counted: more than a matching window loses
PAST_EDGE = 2  # px: where an edge is, is known to about a pixel
JUMP = 0.08  # of the depth behind; a smaller step is bridged by a matching window
MOST_HOLES = 0.3  # usual share: behind such edges nothing can be told
AMBIENT = 3  # px at least, beyond the window, from which the usual share is known
BELOW_MM = 10.0  # several times the noise of a pixel
SLOPES_MM = (0.5, 1.5, 3.0, 6.0)  # of depth from pixel to pixel: on a slope, neighbours are equal by chance less often


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
    """Counts in the rows of images, shape (images, rows, columns), where nothing is beyond the claimed `range_m`.

    Depth is predicted without effects. What is farther than `clip_mm` reads as that: such neighbours are equal, and no
    copies.
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
    frame, row, column, first, last, start = (a[keep] for a in (frame, row, column, first, last, start))
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
        copies += _count(is_copy, frame, row, first, last)
        # what is near has noise of its own
        for low, high, usual_low, usual_high in ((first, column, start, first), (column, last, last, beyond)):
            usual_pairs = float(_count(is_pair, frame, row, usual_low, usual_high).sum())
            usual = float(_count(is_copy, frame, row, usual_low, usual_high).sum()) / max(usual_pairs, 1.0)
            here = _count(is_pair, frame, row, low, high)
            by_chance += usual * here
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
    """For each class of slopes: valid pixels with a valid left neighbour, and those of them that are equal to it."""
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
