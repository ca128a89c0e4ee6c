"""Faults of rows and clocks: values that are not numbers,
time that runs backwards, lost or repeated rows.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.real2sim.problem.log import rows_between, segments_of, table_times
from saltus.real2sim.screening.channel_scales import LogFault
from saltus.recordings.log_units import TIMES
from saltus.recordings.run_log import JOINT_SIGNALS, RunLog, period_of

LONG = 1.6  # times the period: one lost row makes 2
# On each side of a step: the line through them is as certain as a tenth of the largest jitter
ROWS = 50
CATCHING_UP = 10  # rows after a step that a loop needs until it is in time again
FEW = 12  # fewer rows on a side say nothing of a line
ROUNDED_S = 1e-3  # what loggers round their times to, where the period is not much longer
JITTER_SHARE = 0.1  # of a period: less than the smallest that hides a lost row
# Times a millisecond: such a period makes so few long steps that lost rows are most of them
NEARLY = 1.06
SLACK = 1e-3  # of such a time, by the rounding of doubles
# Standard deviation over mean of the distances between long steps: lost rows come at random, near 1
EVEN = 0.3


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
    if (
        _is_rounded(time_s, period) and period > NEARLY * ROUNDED_S
    ):  # its roundings alone make steps as long
        long = long[steps[long] > period + (1.0 + JITTER_SHARE) * ROUNDED_S]
    if _is_even(time_s, steps):
        usual = float(np.median(steps))
        gaps = steps[steps > LONG * usual]
        return int(np.sum(np.rint(gaps / usual) - 1)), float(gaps.max(initial=0.0))
    spread = float(np.subtract(*np.quantile(steps, (0.95, 0.05))))
    lost, longest, line = 0, 0.0, time_s - period * np.arange(len(time_s))
    for place in long[
        np.argsort(-steps[long], kind="stable")
    ]:  # the longest first: its neighbours see it, too
        before, after = (
            line[max(0, place + 1 - ROWS) : place + 1],
            line[place + 1 : place + 1 + ROWS],
        )
        if min(len(before), len(after)) >= FEW:
            shift = _shift(before, after)
        else:  # too near an end: believed where the clock is otherwise even
            shift = steps[place] - period if steps[place] > period + 2.0 * spread else 0.0
        # A gap holds no more
        count = min(round(shift / period), round(float(steps[place]) / period) - 1)
        if count > 0:
            lost, longest = lost + count, max(longest, float(steps[place]))
            line[place + 1 :] -= count * period
    return lost, longest


def _is_even(time_s: Floats, steps: Floats) -> bool:
    """True for a clock so even that each long step speaks for itself."""
    usual = float(np.median(steps))
    short = steps[steps <= LONG * usual]
    return bool(np.all(np.abs(short - usual) < JITTER_SHARE * usual)) and not _is_rounded(
        time_s, usual
    )


def _is_rounded(time_s: Floats, period: float) -> bool:
    """True for times in whole milliseconds, of rows whose period is not much longer."""
    whole = (time_s - time_s[0]) / ROUNDED_S
    return period + ROUNDED_S > LONG * period and bool(
        np.all(np.abs(whole - np.rint(whole)) < SLACK)
    )


def _shift(before: Floats, after: Floats) -> float:
    """By how much times after a step lie beside the line of those before it [s]."""
    skipped = min(CATCHING_UP, len(after) // 2)
    sides = (before, after[skipped:])
    centred = [np.arange(len(side)) - 0.5 * (len(side) - 1) for side in sides]
    slope = sum(c @ side for c, side in zip(centred, sides, strict=True)) / sum(
        c @ c for c in centred
    )
    # Rows between the middles of both sides
    apart = 0.5 * (len(before) + len(after) - skipped) + skipped
    return float(np.mean(sides[1]) - np.mean(sides[0]) - slope * apart)


def _are_roundings(time_s: Floats, long: NDArray[np.int64], period: float) -> bool:
    """True for long steps that rounding to whole milliseconds makes of an even clock,
    as at 990 Hz.
    """
    if len(long) < 3 or not _is_rounded(time_s, period):
        return False
    apart, steps = np.diff(long), np.diff(time_s)
    return (
        bool(np.all(steps[long] < period + (1.0 + JITTER_SHARE) * ROUNDED_S))
        and apart.std() < EVEN * apart.mean()
    )


LARGEST_VALUE = 1e6  # in SI units: larger than any reading of a joint, IMU, base or foot
LARGEST_TIME_S = 1e11  # s: clocks count from their start or from 1970
MIN_ROWS = 20  # fewer rows have no useful median
MAX_LOST = 0.01  # share of lost rows: one in a hundred is a hole in every short window
# Standard deviations of a count: the start of a log may have more than its share of lost rows
CHANCE = 3.0
MAX_GAP_S = 0.1  # longest gap: longer than any delay that is searched for
MAX_REPEATED = 0.01
CONTROL_DT_OFF = 1.3  # ratio of row spacing to the claim
JUMP = 6.0  # times the 99 % quantile, in two joints at once; logs without lost rows stay below 2
MAX_JUMPS = 1  # one jump may be a knock; lost rows come again
ROWS_A_COMMAND = (
    8.0  # times by which rows may come faster or slower than commands: 50 Hz for 400 Hz
)
SAME_RUN = 2.0  # times by which a table of a run may last longer or shorter than that of the joints
SINCE_1970_S = 1.7e9  # today's seconds since 1970
NEAR = 2  # rows before and after, whose speeds bound the motion from row to row
# rad/s: faster joints change their reading in every row, also with a coarse encoder (1.5 mrad)
MOVING = 0.2


def clock_faults(log: RunLog) -> list[LogFault]:
    """Faults of the rows of all tables."""
    faults = [*_numbers(log)]
    if not any(fault.is_fatal for fault in faults):
        faults += _units(log)
    if any(fault.is_fatal for fault in faults):
        return faults
    for name, time_s in table_times(log).items():
        faults += _order(name, time_s)
    if not any(fault.is_fatal for fault in faults) and len(log.joints.time_s) >= MIN_ROWS:
        faults += [*_steps(log), *_lost(log), *_jumps(log), *_repeated(log)]
    return faults


def _stamps(log: RunLog) -> dict[str, Floats]:
    """All times that a log has, by their names in faults."""
    captures = None if log.depth is None else log.depth.capture_s
    return table_times(log) | ({} if captures is None else {"depth captures": captures})


def _units(log: RunLog) -> Iterator[LogFault]:
    """Times in another unit than the claimed seconds between commands,
    or than those of the joints.
    """
    row = float(np.median(np.diff(log.joints.time_s))) if len(log.joints.time_s) > MIN_ROWS else 0.0
    claimed = float(log.meta["control_dt"])
    if factor := _known_factor(row / claimed, ROWS_A_COMMAND):
        text = (
            f"joints: t is {factor:g} times what it can be: rows are {row:.4g} apart, "
            f"control_dt claims {claimed:g} s"
        )
        yield LogFault(name="time_unit", text=f"{text}; {_in_unit(factor)}")
        return
    lasts = float(np.ptp(log.joints.time_s))
    for name, time_s in _stamps(log).items():
        own = float(np.ptp(time_s)) if len(time_s) > MIN_ROWS else 0.0
        factor = _known_factor(own / lasts, SAME_RUN) if lasts > 0.0 and own > 0.0 else None
        if factor:
            text = (
                f"{name}: t is {factor:g} times that of the joints: its rows span {own:.4g}, "
                f"theirs {lasts:.4g}"
            )
            yield LogFault(name="time_unit", text=f"{text}; {_in_unit(factor, is_alone=True)}")


def _known_factor(ratio: float, near: float) -> float | None:
    """The factor of a unit of time that is as near to a ratio as that."""
    known = [1.0 / seconds for name, seconds in TIMES.items() if name != "s"]
    return next(
        (f for each in known for f in (each, 1.0 / each) if 1.0 / near < ratio / f < near), None
    )


def _in_unit(factor: float, is_alone: bool = False) -> str:
    """The unit that a factor of times tells, and the cure."""
    unit = next((name for name, seconds in TIMES.items() if abs(factor * seconds - 1.0) < 1e-6), "")
    if not unit:
        return "turned into seconds twice?"
    return f"in {unit}? " + (
        "Write seconds" if is_alone else f'Then say time_unit = "{unit}" in units of meta.json'
    )


def _numbers(log: RunLog) -> Iterator[LogFault]:
    for name, time_s in _stamps(log).items():
        beyond = len(time_s) > 0 and bool(np.min(time_s) > LARGEST_TIME_S)
        if (
            factor := _known_factor(float(np.min(time_s)) / SINCE_1970_S, SAME_RUN)
            if beyond
            else None
        ):
            text = f"{name}: 't' is {factor:g} times the seconds since 1970: {_in_unit(factor)}"
            yield LogFault(name="time_unit", text=text)
        else:
            yield from _impossible(f"{name}: 't' has", time_s, LARGEST_TIME_S)
    signals = {s: values for s in JOINT_SIGNALS if (values := getattr(log.joints, s)) is not None}
    tables = {
        n: t.values
        for n, t in (("imu", log.imu), ("base", log.base), ("feet", log.feet))
        if t is not None
    }
    for name, values in {**signals, **tables}.items():
        yield from _impossible(f"{name}:", values, LARGEST_VALUE)
    if len(log.joints.time_s) < MIN_ROWS:
        text = f"joints: {len(log.joints.time_s)} rows are too few to compare with anything"
        yield LogFault(name="too_short", text=text, is_fatal=False)


def _impossible(where: str, values: Floats, largest: float) -> Iterator[LogFault]:
    """Faults of values that are not numbers or too large."""
    wrong = ~np.isfinite(values)
    if wrong.any():
        yield LogFault(
            name="not_a_number",
            text=f"{where} {_share(wrong)} values that are no numbers; fill them",
        )
    beyond = np.abs(np.where(wrong, 0.0, values)) > largest
    if beyond.any():
        yield LogFault(
            name="too_large",
            text=f"{where} {_share(beyond)} values beyond {largest:g}: a broken reading?",
        )


def _share(wrong: NDArray[np.bool_]) -> str:
    return f"{int(wrong.sum())} of {wrong.size}"


def _order(name: str, time_s: Floats) -> Iterator[LogFault]:
    steps = np.diff(time_s)
    back = np.flatnonzero(steps < 0)
    if len(back):
        text = f"{name}: time runs backwards {len(back)} times, first by {-steps[back[0]]:.4g} s"
        yield LogFault(name="time_backwards", text=text)
    same = int(np.sum(steps == 0))
    if same:
        text = f"{name}: {same / len(steps):.1%} of the rows bear the time of the row before them"
        yield LogFault(
            name="repeated_rows", text=text, is_fatal=_is_more(same, MAX_REPEATED, len(steps))
        )


def _is_more(count: int, share: float, total: int) -> bool:
    """True where a count is a larger share of a total than chance makes of this one."""
    return bool(count > share * total + CHANCE * np.sqrt(share * total))


def _steps(log: RunLog) -> Iterator[LogFault]:
    """Compares the time between rows with the claimed time between commands."""
    claimed, found = float(log.meta["control_dt"]), period_of(log.joints.time_s)
    if found > CONTROL_DT_OFF * claimed:
        text = (
            f"joints: rows are {1e3 * found:.4g} ms apart, control_dt claims {1e3 * claimed:.4g} ms"
        )
        yield LogFault(name="control_dt", text=text)
        return
    if log.joints.q_des is None:
        return
    changes = np.flatnonzero(np.any(np.diff(log.joints.q_des, axis=0) != 0, axis=1))
    if len(changes) < MIN_ROWS:
        return
    period = float(np.median(np.diff(log.joints.time_s[changes])))
    if claimed > CONTROL_DT_OFF * period:
        text = (
            f"joints: commands change every {1e3 * period:.4g} ms, control_dt claims "
            f"{1e3 * claimed:.4g} ms"
        )
        yield LogFault(name="control_dt", text=text)


def _lost(log: RunLog) -> Iterator[LogFault]:
    """Missing rows within segments; between segments a logger may pause."""
    time_s = log.joints.time_s
    lost, longest, between = 0, 0.0, rows_between(time_s)
    for segment in segments_of(log):
        count, gap = lost_rows(
            time_s[between(segment.start_s, np.nextafter(segment.end_s, np.inf))]
        )
        lost, longest = lost + count, max(longest, gap)
    if lost:
        text = (
            f"joints: {lost} rows ({lost / len(time_s):.1%}) are missing, the longest gap is "
            f"{1e3 * longest:.0f} ms"
        )
        fatal = _is_more(lost, MAX_LOST, len(time_s)) or longest > MAX_GAP_S
        yield LogFault(name="lost_rows", text=text, is_fatal=fatal)


def _jumps(log: RunLog) -> Iterator[LogFault]:
    """Missing rows although the clock goes on evenly:
    joints move farther than their speeds allow.
    """
    time_s = log.joints.time_s
    if len(time_s) < MIN_ROWS:
        return
    beyond, usual_s = _beyond_speed(log), period_of(time_s)
    # a pause of the logger shows in the clock, and one joint alone may have an encoder fault
    count = min(2, beyond.shape[1])
    at = (np.sum(beyond > 0.0, axis=1) >= count) & (np.diff(time_s) <= LONG * usual_s)
    if at.any():
        text = (
            f"joints: {int(at.sum())} times several joints jump between two rows, farthest by "
            f"{float(beyond[at].max()):.2g} rad, while the clock goes on: rows are missing"
        )
        yield LogFault(name="hidden_gaps", text=text, is_fatal=int(at.sum()) > MAX_JUMPS)


def _beyond_speed(log: RunLog) -> Floats:
    """Motion of joints between rows where it exceeds the speeds of neighbouring rows [rad],
    else 0.
    """
    q, dq = log.joints.q, log.joints.dq
    moved = np.diff(q, axis=0)
    rows = np.arange(len(moved))
    others = [moved[np.clip(rows + k, 0, len(moved) - 1)] for k in range(-NEAR, NEAR + 1) if k != 0]
    if dq is not None:
        row_s = period_of(log.joints.time_s)
        others += [row_s * dq[np.clip(rows + k, 0, len(moved))] for k in range(1 - NEAR, NEAR + 1)]
    low, high = np.min(others, axis=0), np.max(others, axis=0)
    outside = np.maximum(0.0, np.maximum(moved - high, low - moved))
    usual = np.quantile(np.abs(moved - 0.5 * (low + high)), 0.99, axis=0)
    return np.where(outside > JUMP * usual, np.abs(moved), 0.0)


def _repeated(log: RunLog) -> Iterator[LogFault]:
    """Rows with the state of the row before although the robot moves."""
    q, time_s = log.joints.q, log.joints.time_s
    span = min(10, len(q) // 2)  # rows, far enough apart to separate motion from noise
    rate = np.abs(q[span:] - q[:-span]) / (time_s[span:] - time_s[:-span])[:, None]
    moving = np.sum(rate > MOVING, axis=1) >= min(2, q.shape[1])
    same = np.all(np.diff(q, axis=0) == 0, axis=1)
    if log.joints.dq is not None:
        same &= np.all(np.diff(log.joints.dq, axis=0) == 0, axis=1)
    middle = span // 2
    same = same[middle : middle + len(moving)]
    if not moving.any():
        return
    seen = same[moving[: len(same)]]
    count = int(seen.sum())
    if count:
        text = (
            f"joints: {count / len(seen):.1%} of the rows repeat the state of the row before "
            "while the robot moves"
        )
        yield LogFault(
            name="repeated_rows", text=text, is_fatal=_is_more(count, MAX_REPEATED, len(seen))
        )
