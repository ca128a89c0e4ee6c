"""Rows that a logger lost, told from rows whose times are rounded, or late and caught up with.

A lost row moves all later times by a period, for good. Rounding and jitter do not: the times come
back to the line on which they were. So each long step is looked at from both sides.
"""

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.recordings.run_log import period_of

LONG = 1.6  # times the period: one lost row makes 2
ROWS = 50  # on each side of a step: the line through them is as certain as a tenth of the largest jitter
CATCHING_UP = 10  # rows after a step that a loop needs until it is in time again
FEW = 12  # fewer rows on a side say nothing of a line
ROUNDED_S = 1e-3  # what loggers round their times to, where the period is not much longer
JITTER = 0.1  # of a period: less than the smallest that hides a lost row
NEARLY = 1.06  # times a millisecond: such a period makes so few long steps that lost rows are most of them
SLACK = 1e-3  # of such a time, by the rounding of doubles
EVEN = 0.3  # standard deviation over mean of the distances between long steps: lost rows come at random, near 1


def lost_rows(time_s: Floats) -> tuple[int, float]:
    """Number of rows that are missing between others, and the longest gap that they leave [s].

    Args:
        time_s: Times of the rows that are there [s], rising, shape (rows,).
    """
    if len(time_s) < 3:
        return 0, 0.0
    steps, period = np.diff(time_s), period_of(time_s)
    long = np.flatnonzero(steps > LONG * period)
    if period <= 0.0 or not len(long) or _are_roundings(time_s, long, period):
        return 0, 0.0
    if _is_rounded(time_s, period) and period > NEARLY * ROUNDED_S:  # its roundings alone make steps as long
        long = long[steps[long] > period + (1.0 + JITTER) * ROUNDED_S]
    if _is_even(time_s, steps):
        usual = float(np.median(steps))
        gaps = steps[steps > LONG * usual]
        return int(np.sum(np.rint(gaps / usual) - 1)), float(gaps.max(initial=0.0))
    spread = float(np.subtract(*np.quantile(steps, (0.95, 0.05))))
    lost, longest, line = 0, 0.0, time_s - period * np.arange(len(time_s))
    for place in long[np.argsort(-steps[long], kind="stable")]:  # the longest first: its neighbours see it, too
        before, after = line[max(0, place + 1 - ROWS) : place + 1], line[place + 1 : place + 1 + ROWS]
        if min(len(before), len(after)) >= FEW:
            shift = _shift(before, after)
        else:  # too near an end: believed where the clock is otherwise even
            shift = steps[place] - period if steps[place] > period + 2.0 * spread else 0.0
        count = min(round(shift / period), round(float(steps[place]) / period) - 1)  # a gap holds no more
        if count > 0:
            lost, longest = lost + count, max(longest, float(steps[place]))
            line[place + 1 :] -= count * period
    return lost, longest


def _is_even(time_s: Floats, steps: Floats) -> bool:
    """True for a clock so even that each long step speaks for itself."""
    usual = float(np.median(steps))
    short = steps[steps <= LONG * usual]
    return bool(np.all(np.abs(short - usual) < JITTER * usual)) and not _is_rounded(time_s, usual)


def _is_rounded(time_s: Floats, period: float) -> bool:
    """True for times in whole milliseconds, of rows whose period is not much longer."""
    whole = (time_s - time_s[0]) / ROUNDED_S
    return period + ROUNDED_S > LONG * period and bool(np.all(np.abs(whole - np.rint(whole)) < SLACK))


def _shift(before: Floats, after: Floats) -> float:
    """By how much times after a step lie beside the line of those before it [s]."""
    skipped = min(CATCHING_UP, len(after) // 2)
    sides = (before, after[skipped:])
    centred = [np.arange(len(side)) - 0.5 * (len(side) - 1) for side in sides]
    slope = sum(c @ side for c, side in zip(centred, sides, strict=True)) / sum(c @ c for c in centred)
    apart = 0.5 * (len(before) + len(after) - skipped) + skipped  # rows between the middles of both sides
    return float(np.mean(sides[1]) - np.mean(sides[0]) - slope * apart)


def _are_roundings(time_s: Floats, long: NDArray[np.int64], period: float) -> bool:
    """True for long steps that rounding to whole milliseconds makes of an even clock, as at 990 Hz."""
    if len(long) < 3 or not _is_rounded(time_s, period):
        return False
    apart, steps = np.diff(long), np.diff(time_s)
    return bool(np.all(steps[long] < period + (1.0 + JITTER) * ROUNDED_S)) and apart.std() < EVEN * apart.mean()
