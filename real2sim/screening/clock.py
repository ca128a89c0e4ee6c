"""Faults of rows and clocks: values that are not numbers, time that runs backwards, lost or repeated rows."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.real2sim.problem.log import rows_between, segments_of
from saltus.real2sim.screening.fault import Fault
from saltus.real2sim.screening.gaps import LONG, lost_rows
from saltus.recordings.run_log import JOINT_SIGNALS, RunLog, period_of
from saltus.recordings.units import TIMES

LARGEST_VALUE = 1e6  # in SI units: larger than any reading of a joint, IMU, base or foot
LARGEST_TIME_S = 1e11  # s: clocks count from their start or from 1970
MIN_ROWS = 20  # fewer rows have no useful median
MAX_LOST = 0.01  # share of lost rows: one in a hundred is a hole in every short window
CHANCE = 3.0  # standard deviations of a count: the start of a log may have more than its share of lost rows
MAX_GAP_S = 0.1  # longest gap: longer than any delay that is searched for
MAX_REPEATED = 0.01
CONTROL_DT_OFF = 1.3  # ratio of row spacing to the claim
JUMP = 6.0  # times the 99 % quantile, in two joints at once; logs without lost rows stay below 2
MAX_JUMPS = 1  # one jump may be a knock; lost rows come again
ROWS_A_COMMAND = 8.0  # times by which rows may come faster or slower than commands: 50 Hz for 400 Hz
SAME_RUN = 2.0  # times by which a table of a run may last longer or shorter than that of the joints
SINCE_1970_S = 1.7e9  # today's seconds since 1970
NEAR = 2  # rows before and after, whose speeds bound the motion from row to row
MOVING = 0.2  # rad/s: faster joints change their reading in every row, also with a coarse encoder (1.5 mrad)


def clock_faults(log: RunLog) -> list[Fault]:
    """Faults of the rows of all tables."""
    faults = [*_numbers(log)]
    if not any(fault.is_fatal for fault in faults):
        faults += _units(log)
    if any(fault.is_fatal for fault in faults):
        return faults
    for name, time_s in _clocks(log):
        faults += _order(name, time_s)
    if not any(fault.is_fatal for fault in faults) and len(log.joints.time_s) >= MIN_ROWS:
        faults += [*_steps(log), *_lost(log), *_jumps(log), *_repeated(log)]
    return faults


def _clocks(log: RunLog) -> Iterator[tuple[str, Floats]]:
    yield "joints", log.joints.time_s
    for name, table in (("imu", log.imu), ("base", log.base), ("feet", log.feet)):
        if table is not None:
            yield name, table.time_s
    if log.depth is not None:
        yield "depth", log.depth.arrival_s


def _units(log: RunLog) -> Iterator[Fault]:
    """Times in another unit than the claimed seconds between commands, or than those of the joints."""
    row = float(np.median(np.diff(log.joints.time_s))) if len(log.joints.time_s) > MIN_ROWS else 0.0
    claimed = float(log.meta["control_dt"])
    if factor := _known_factor(row / claimed, ROWS_A_COMMAND):
        text = (
            f"joints: t is {factor:g} times what it can be: rows are {row:.4g} apart, control_dt claims {claimed:g} s"
        )
        yield Fault(name="time_unit", text=f"{text}; {_in_unit(factor)}")
        return
    stamps = {name: time_s for name, time_s in _clocks(log) if name != "joints"}
    if log.depth is not None and log.depth.capture_s is not None:
        stamps["depth captures"] = log.depth.capture_s
    lasts = float(np.ptp(log.joints.time_s))
    for name, time_s in stamps.items():
        own = float(np.ptp(time_s)) if len(time_s) > MIN_ROWS else 0.0
        factor = _known_factor(own / lasts, SAME_RUN) if lasts > 0.0 and own > 0.0 else None
        if factor:
            text = f"{name}: t is {factor:g} times that of the joints: its rows span {own:.4g}, theirs {lasts:.4g}"
            yield Fault(name="time_unit", text=f"{text}; {_in_unit(factor, is_alone=True)}")


def _known_factor(ratio: float, near: float) -> float | None:
    """The factor of a unit of time that is as near to a ratio as that."""
    known = [1.0 / seconds for name, seconds in TIMES.items() if name != "s"]
    return next((f for each in known for f in (each, 1.0 / each) if 1.0 / near < ratio / f < near), None)


def _in_unit(factor: float, is_alone: bool = False) -> str:
    """The unit that a factor of times tells, and the cure."""
    unit = next((name for name, seconds in TIMES.items() if abs(factor * seconds - 1.0) < 1e-6), "")
    if not unit:
        return "turned into seconds twice?"
    return f"in {unit}? " + ("Write seconds" if is_alone else f'Then say time_unit = "{unit}" in units of meta.json')


def _numbers(log: RunLog) -> Iterator[Fault]:
    stamps = dict(_clocks(log))
    if log.depth is not None and log.depth.capture_s is not None:
        stamps["depth captures"] = log.depth.capture_s
    for name, time_s in stamps.items():
        beyond = len(time_s) > 0 and bool(np.min(time_s) > LARGEST_TIME_S)
        if factor := _known_factor(float(np.min(time_s)) / SINCE_1970_S, SAME_RUN) if beyond else None:
            text = f"{name}: 't' is {factor:g} times the seconds since 1970: {_in_unit(factor)}"
            yield Fault(name="time_unit", text=text)
        else:
            yield from _impossible(f"{name}: 't' has", time_s, LARGEST_TIME_S)
    signals = {s: values for s in JOINT_SIGNALS if (values := getattr(log.joints, s)) is not None}
    tables = {n: t.values for n, t in (("imu", log.imu), ("base", log.base), ("feet", log.feet)) if t is not None}
    for name, values in {**signals, **tables}.items():
        yield from _impossible(f"{name}:", values, LARGEST_VALUE)
    if len(log.joints.time_s) < MIN_ROWS:
        text = f"joints: {len(log.joints.time_s)} rows are too few to compare with anything"
        yield Fault(name="too_short", text=text, is_fatal=False)


def _impossible(where: str, values: Floats, largest: float) -> Iterator[Fault]:
    """Faults of values that are not numbers or too large."""
    wrong = ~np.isfinite(values)
    if wrong.any():
        yield Fault(name="not_a_number", text=f"{where} {_share(wrong)} values that are no numbers; fill them")
    beyond = np.abs(np.where(wrong, 0.0, values)) > largest
    if beyond.any():
        yield Fault(name="too_large", text=f"{where} {_share(beyond)} values beyond {largest:g}: a broken reading?")


def _share(wrong: NDArray[np.bool_]) -> str:
    return f"{int(wrong.sum())} of {wrong.size}"


def _order(name: str, time_s: Floats) -> Iterator[Fault]:
    steps = np.diff(time_s)
    back = np.flatnonzero(steps < 0)
    if len(back):
        text = f"{name}: time runs backwards {len(back)} times, first by {-steps[back[0]]:.4g} s"
        yield Fault(name="time_backwards", text=text)
    same = int(np.sum(steps == 0))
    if same:
        text = f"{name}: {same / len(steps):.1%} of the rows bear the time of the row before them"
        yield Fault(name="repeated_rows", text=text, is_fatal=_is_more(same, MAX_REPEATED, len(steps)))


def _is_more(count: int, share: float, total: int) -> bool:
    """True where a count is a larger share of a total than chance makes of this one."""
    return bool(count > share * total + CHANCE * np.sqrt(share * total))


def _steps(log: RunLog) -> Iterator[Fault]:
    """Compares the time between rows with the claimed time between commands."""
    claimed, found = float(log.meta["control_dt"]), period_of(log.joints.time_s)
    if found > CONTROL_DT_OFF * claimed:
        text = f"joints: rows are {1e3 * found:.4g} ms apart, control_dt claims {1e3 * claimed:.4g} ms"
        yield Fault(name="control_dt", text=text)
        return
    if log.joints.q_des is None:
        return
    changes = np.flatnonzero(np.any(np.diff(log.joints.q_des, axis=0) != 0, axis=1))
    if len(changes) < MIN_ROWS:
        return
    period = float(np.median(np.diff(log.joints.time_s[changes])))
    if claimed > CONTROL_DT_OFF * period:
        text = f"joints: commands change every {1e3 * period:.4g} ms, control_dt claims {1e3 * claimed:.4g} ms"
        yield Fault(name="control_dt", text=text)


def _lost(log: RunLog) -> Iterator[Fault]:
    """Missing rows within segments; between segments a logger may pause."""
    time_s = log.joints.time_s
    lost, longest, between = 0, 0.0, rows_between(time_s)
    for segment in segments_of(log):
        count, gap = lost_rows(time_s[between(segment.start_s, np.nextafter(segment.end_s, np.inf))])
        lost, longest = lost + count, max(longest, gap)
    if lost:
        text = f"joints: {lost} rows ({lost / len(time_s):.1%}) are missing, the longest gap is {1e3 * longest:.0f} ms"
        fatal = _is_more(lost, MAX_LOST, len(time_s)) or longest > MAX_GAP_S
        yield Fault(name="lost_rows", text=text, is_fatal=fatal)


def _jumps(log: RunLog) -> Iterator[Fault]:
    """Missing rows although the clock goes on evenly: joints move farther than their speeds allow."""
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
        yield Fault(name="hidden_gaps", text=text, is_fatal=int(at.sum()) > MAX_JUMPS)


def _beyond_speed(log: RunLog) -> Floats:
    """Motion of joints between rows where it exceeds the speeds of neighbouring rows [rad], else 0."""
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


def _repeated(log: RunLog) -> Iterator[Fault]:
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
        text = f"joints: {count / len(seen):.1%} of the rows repeat the state of the row before while the robot moves"
        yield Fault(name="repeated_rows", text=text, is_fatal=_is_more(count, MAX_REPEATED, len(seen)))
