"""Invalid and copied pixels to the left of near objects: what no mean of depth shows."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from real2sim.problem import Floats

WINDOW = 12  # px to the left of an edge in which holes and copies are counted: more than a matching window loses
PAST_EDGE = 2  # px: where an edge is, is known to about a pixel
JUMP = 0.08  # of the depth behind: a smaller step is bridged by a matching window
MOST_HOLES = 0.3  # usual share: behind such edges nothing can be told
AMBIENT = 3  # px at least, beyond the window, from which the usual share is known


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeCounts:
    """Counts at left edges of near objects, less what is usual elsewhere in the same rows."""

    frame: NDArray[np.int64]
    """Place of the image among those looked at, shape (edges,)."""
    holes: Floats
    """Invalid pixels [px], shape (edges,)."""
    copies: Floats
    """Pixels that are exactly as their left neighbour [px], shape (edges,)."""


def edge_counts(predicted_m: Floats, measured_mm: NDArray[np.uint16], range_m: float) -> EdgeCounts:
    """Counts in the rows of images, both of shape (images, rows, columns), where nothing is beyond the range."""
    edge = predicted_m[..., 1:] < (1.0 - JUMP) * predicted_m[..., :-1]
    frame, row, column = np.nonzero(edge)
    column = column + 1  # the first pixel of the near object
    first, last = column - WINDOW, column + PAST_EDGE
    keep = (first >= AMBIENT) & (last <= measured_mm.shape[2])
    frame, row, first, last = (a[keep] for a in (frame, row, first, last))
    start = np.maximum(first - WINDOW, 0)
    keep = _count(edge, frame, row, start, last - 1) == 1
    keep &= _count(predicted_m >= range_m, frame, row, start, last) == 0
    frame, row, first, last, start = (a[keep] for a in (frame, row, first, last, start))
    hole = measured_mm == 0
    copy = np.zeros_like(hole)
    copy[..., 1:] = (measured_mm[..., 1:] == measured_mm[..., :-1]) & ~hole[..., 1:]
    holes, copies = _count(hole, frame, row, first, last), _count(copy, frame, row, first, last)
    usual_holes, usual_copies = (
        np.mean(_count(marked, frame, row, start, first)) / max(float(np.mean(first - start)), 1.0)
        if frame.size
        else 0.0
        for marked in (hole, copy)
    )
    if usual_holes > MOST_HOLES:
        return EdgeCounts(frame=frame[:0], holes=holes[:0], copies=copies[:0])
    # a pixel that the edge has taken is not lost or copied once more by the usual chance
    return EdgeCounts(
        frame=frame,
        holes=(holes - usual_holes * (last - first)) / max(1.0 - usual_holes, 0.1),
        copies=(copies - usual_copies * (last - first - holes)) / max(1.0 - usual_copies, 0.1),
    )


def _count(
    marked: NDArray[np.bool_],
    frame: NDArray[np.int64],
    row: NDArray[np.int64],
    first: NDArray[np.int64],
    last: NDArray[np.int64],
) -> Floats:
    """Marked pixels in the columns [first, last) of rows, shape (n,)."""
    total = np.cumsum(np.pad(marked, ((0, 0), (0, 0), (1, 0))), axis=2)
    return np.asarray(total[frame, row, last] - total[frame, row, first], dtype=np.float64)
