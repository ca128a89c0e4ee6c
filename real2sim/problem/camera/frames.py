"""The images of a run log: which are new, which were lost, and when they were exposed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Indices
from saltus.recordings.run_log import DepthTable

# Of the median gap between arrivals: from here on an image is missing where numbers do not tell
LATE = 1.6
PAUSE = 20.0  # of the median gap: from here on nothing was recorded
MOSTLY_EQUAL = (
    0.5  # a scene without motion and noise repeats every image: then equality says nothing
)
JITTER_S = 3e-4  # arrivals that scatter by less are as good as regular


@dataclass(frozen=True, kw_only=True, eq=False)
class Frames:
    """New images of a log in the order of their arrival, repeats left out."""

    index: Indices
    """Index of each in the log, shape (n,)."""
    stamp_s: Floats
    """Exposure plus total latency [s], as far as the log knows it: arrival where it has no time of
    capture."""
    jitter_s: Floats
    """Excess of `stamp_s` over frames at a constant rate [s]; 0 where that cannot be told."""
    filtered: Indices
    """Index of each image in the log that a temporal filter has seen: new ones, and repeats that
    are not equal to the image before, shape (filtered,)."""
    shown: Indices
    """Which of the new images each of them shows, shape (filtered,)."""
    due_s: Floats
    """When an image should have come [s], lost ones included, shape (sent,)."""
    lost: NDArray[np.bool_]
    """Which of them did not come, or came as a repeat, shape (sent,)."""


def frames_of(depth: DepthTable) -> Frames:
    """Sorts out what came: repeats, gaps, times."""
    repeated, same = _repeats(depth)
    filtered = np.flatnonzero(~(repeated & same))
    index = np.flatnonzero(~repeated)
    stamp_s = depth.arrival_s[index]
    if depth.capture_s is not None and np.isfinite(depth.capture_s).all():
        captured = depth.capture_s[index]
        stamp_s = captured + np.median(stamp_s - captured)
    due_s, lost = _losses(depth, repeated)
    return Frames(
        index=index,
        stamp_s=stamp_s,
        jitter_s=_jitter(stamp_s, depth.frame_id[index]),
        filtered=filtered,
        shown=(np.cumsum(~repeated) - 1)[filtered],
        due_s=due_s,
        lost=lost,
    )


def _repeats(depth: DepthTable) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Images that are the one before, by number or by content, and those that are equal to it.

    Shape (n,) each.
    """
    count = len(depth.frame_id)
    by_number, by_content = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    by_number[1:] = depth.frame_id[1:] == depth.frame_id[:-1]
    flat = depth.depth_mm.reshape(count, -1)
    by_content[1:] = [np.array_equal(a, b) for a, b in zip(flat[1:], flat[:-1], strict=True)]
    return (by_number if by_content.mean() > MOSTLY_EQUAL else by_number | by_content), by_content


def _losses(depth: DepthTable, repeated: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.bool_]]:
    """Times at which images were due and whether each was lost."""
    gap_s = np.diff(depth.arrival_s)
    if not gap_s.size:
        return depth.arrival_s, repeated
    new = np.flatnonzero(~repeated)
    step = np.diff(depth.frame_id[new])
    if np.all(
        np.diff(depth.frame_id) <= 1
    ):  # numbers are given on arrival: only the clock shows a gap
        new = np.arange(len(repeated))
        usual = np.median(gap_s)
        is_loss = (gap_s > LATE * usual) & (gap_s < PAUSE * usual)
        step = np.where(is_loss, np.round(gap_s / max(usual, 1e-9)), 1).astype(np.int64)
    # a repeat has come in the place of the image whose number is missing: it is lost once, not
    # twice
    missing = np.maximum(step - np.diff(new), 0)
    after = np.repeat(new[1:] - 1, missing)
    share = np.arange(len(after)) - np.repeat(np.cumsum(missing) - missing, missing) + 1.0
    share /= np.repeat(missing, missing) + 1.0
    absent_s = depth.arrival_s[after] + share * gap_s[after]
    due_s = np.concatenate([depth.arrival_s, absent_s])
    lost = np.concatenate([repeated, np.ones(len(absent_s), dtype=bool)])
    order = np.argsort(due_s, kind="stable")
    return due_s[order], lost[order]


def _jitter(stamp_s: Floats, frame_id: Indices) -> Floats:
    """Scatter of the stamps about a straight line over the numbers [s].

    None where numbers and times disagree.
    """
    none = np.zeros_like(stamp_s)
    if len(stamp_s) < 10 or np.any(np.diff(frame_id) <= 0):
        return none
    number = (frame_id - frame_id[0]).astype(np.float64)
    line = np.polynomial.Polynomial.fit(number, stamp_s, 1)
    jitter = stamp_s - line(number)
    period = np.median(np.diff(stamp_s))
    spread = float(np.std(jitter))
    # a slow wander is drift of a clock or a camera that keeps no rate, not the scatter of arrivals
    wander = float(np.std(jitter[:-1] + jitter[1:])) > 1.8 * spread
    return none if spread < JITTER_S or spread > 0.5 * period or wander else jitter
