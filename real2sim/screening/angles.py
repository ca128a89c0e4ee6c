"""Compares the scales of joint angles, their targets and their rates, in any unit."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.real2sim.problem.log import claimed_model
from saltus.real2sim.screening.channel_scales import (
    RIGHT,
    LogFault,
    by_cause,
    gear_reductions,
    is_off,
    step_means,
    unit_fault,
    unit_of,
)
from saltus.recordings.log_units import ANGLES
from saltus.recordings.run_log import JointTable, RunLog
from saltus.robots.robot import JOINTS, Robot

FULL_TURN = 2 * np.pi  # rad: no joint of a legged robot turns further
BEYOND_LIMIT = 0.15  # rad: a bias of 0.1 and the compliance of a stop stay within it
POSTURE = 0.3
"""Angle from zero on average from which a posture tells a factor [rad]: bias and sagging change it
by half at most."""
MOVES = 0.1
"""Range of a slow command from which its factor is read [rad]."""
FOLLOWS = 0.9
"""Correlation from which an angle follows its command, or a rate its angle, whatever their units
are."""
ONE_MOTION = 0.5
"""Correlation from which a rate and its angle show one motion, and what differs is noise of both;
columns of two joints have less."""
AGREE = 0.25
"""Share by which the factors of posture and motion of one joint may differ: soft drives follow by
0.8."""
RATE_S = 0.1
"""Moving average over which dq must equal the rate of q [s]: longer than any delay or filter."""
MOVING = 0.1
"""RMS of the rate of q from which dq is compared [rad/s]; noise of 2 mrad in q makes 0.03 of it."""
BARELY = 0.02
"""RMS of the rate of q from which a dq is compared that shows the very motion of q, as no noise
does [rad/s]."""
TYPICAL = 0.5
"""Angles of legs are from 0.1 to 2.5 rad: the geometric mean."""
KNOWN = (
    1.0 / ANGLES["deg"],
    1.0 / ANGLES["mrad"],
    1.0 / ANGLES["rev"],
    ANGLES["deg"],
    ANGLES["mrad"],
    -1.0,
)
"""Factors that angles of all joints have: units, units that were turned into rad twice, a sign."""


def angle_faults(log: RunLog, q: Floats, q_des: Floats) -> Iterator[LogFault]:
    """Faults of q or q_des whose scales differ.

    Args:
        log: Of the robot.
        q: Slow motion of the joints, shape (rows, joints).
        q_des: That of their commands.
    """
    factors = {
        joint: each
        for joint in range(q.shape[1])
        if is_off(each := _factor(q[:, joint], q_des[:, joint]))
    }
    # hips that hardly move may sag by as much as they are told; what is off by a unit is so for
    # more than one joint
    moved = [j for j in factors if np.ptp(q_des[:, j]) > MOVES]
    if not moved and len(factors) < 3:
        return
    names, gears = log.meta["joints"], gear_reductions(log)
    for where, factor in by_cause(names, factors):
        own = [joint for joint in factors if abs(factors[joint] / factor - 1.0) < AGREE]
        signal = _wrong_one(log, own, factor)
        other = "q_des" if signal == "q" else "q"
        times = factor if signal == "q" else 1.0 / factor
        is_deg = unit_of(signal, times, gears, AGREE) == "deg"
        reach = _reach(getattr(log.joints, signal), is_deg)
        than = f"{other} in slow motion{f' ({reach})' if reach else ''}"
        yield unit_fault(
            "degrees" if is_deg else "angle_unit",
            signal,
            f"{signal} of {where}",
            times,
            than,
            gears,
            AGREE,
        )


def _factor(q: Floats, q_des: Floats) -> float:
    """Angle over command by motion and by posture, 1 where they tell none or disagree."""
    moved, told = q - q.mean(), q_des - q_des.mean()
    power = float(np.sum(told**2))
    by_motion = np.nan
    if power > 0.0 and abs(np.sum(moved * told)) > FOLLOWS * np.sqrt(power * np.sum(moved**2)):
        by_motion = float(np.sum(moved * told)) / power
    elif max(np.ptp(q), np.ptp(q_des)) > MOVES:
        return 1.0  # it follows another joint, or nothing
    middles = abs(q.mean()), abs(q_des.mean())
    by_posture = (
        float(q.mean() / q_des.mean()) if max(middles) > POSTURE and min(middles) > 0.0 else np.nan
    )
    known = [factor for factor in (by_motion, by_posture) if np.isfinite(factor)]
    if not known or (len(known) == 2 and abs(known[0] / known[1] - 1.0) > AGREE):
        return 1.0
    # a posture that is the opposite of another joint's, but for a sign, is of that joint
    return known[-1] if known[-1] > 0.0 or abs(known[-1] + 1.0) < AGREE else 1.0


def _wrong_one(log: RunLog, joints: list[int], factor: float) -> str:
    """The one of q and q_des in another unit:
    by rates, or else the one less like angles of legs.
    """
    slopes = (
        rate_slopes(log.joints.time_s, log.joints.q, log.joints.dq)
        if log.joints.dq is not None
        else None
    )
    if slopes is not None and (told := slopes[joints][np.isfinite(slopes[joints])]).size:
        slope = float(np.median(told))
        for signal, own in (("q", slope * factor), ("q_des", slope)):
            if abs(own - 1.0) < AGREE:
                return signal
    sizes = {
        signal: float(np.sqrt(np.mean(getattr(log.joints, signal)[:, joints] ** 2)))
        for signal in ("q", "q_des")
    }
    if factor < 0.0:
        return "q"
    return max(sizes, key=lambda signal: abs(np.log(max(sizes[signal], 1e-9) / TYPICAL)))


def posture_faults(log: RunLog) -> Iterator[LogFault]:
    """Faults of all angles together, by the joints' limits or by a full turn."""
    names, gears = log.meta["joints"], gear_reductions(log)
    for signal, values in (("q", log.joints.q), ("q_des", log.joints.q_des)):
        if values is None:
            continue
        turns = np.percentile(np.abs(values), 95, axis=0)
        wrong = turns > FULL_TURN
        factors = _by_limits(log, values, gears)
        if factors is None and not wrong.any():
            continue
        if factors is None:
            factors = np.full(len(names), _by_turns(float(turns.max())))
        told = dict(enumerate(factors.tolist())) if factors.shape == turns.shape else {}
        both = " and q_des" if signal == "q" and _are_alike(log.joints) else ""
        for where, factor in by_cause(names, told):
            is_deg = unit_of(signal, factor, gears) == "deg"
            than = (
                f"what they can be ({_reach(values, is_deg) or 'beyond the limits of the joints'})"
            )
            fault = unit_fault(
                "angle_unit", signal, f"{signal}{both} of {where}", factor, than, gears
            )
            yield replace(fault, name="degrees") if is_deg else fault
        return  # in rad, speeds would be others


def _reach(values: Floats, is_deg: bool) -> str:
    """Says of angles that no joint turns so far; empty where one may."""
    reached = float(np.percentile(np.abs(values), 95, axis=0).max())
    told = f"it reaches {reached:.4g}, more than a full turn in rad{'; degrees?' if is_deg else ''}"
    return told if reached > FULL_TURN else ""


def _are_alike(joints: JointTable) -> bool:
    """True where q and q_des are in one unit."""
    if joints.q_des is None:
        return False
    ratio = float(
        np.sum(joints.q * joints.q_des) / max(np.sum(joints.q_des**2), np.finfo(np.float64).tiny)
    )
    return RIGHT[0] < ratio < RIGHT[1]


def _by_turns(reached: float) -> float:
    """The likeliest factor of angles of which nothing is known but how far they reach."""
    larger = [factor for factor in KNOWN if factor > 1.0]
    return min(larger, key=lambda factor: abs(np.log(reached / factor / (3.0 * TYPICAL))))


def _by_limits(log: RunLog, values: Floats, gears: tuple[float, ...]) -> Floats | None:
    """Factors without which all joints are within their limits; None if they are, or none helps."""
    robot, names = claimed_model(log), [name.removesuffix("_joint") for name in log.meta["joints"]]
    if not isinstance(robot, Robot) or not set(names) <= set(JOINTS):
        return None
    index = [JOINTS.index(name) for name in names]
    low, high = robot.joint_lower[index] - BEYOND_LIMIT, robot.joint_upper[index] + BEYOND_LIMIT
    middle, stand = np.median(values, axis=0), robot.stand_pose[index]
    # one joint alone has another fault, and columns of zeros were not measured
    is_measured = bool((np.ptp(values, axis=0) > 0.0).any())
    if not is_measured or np.sum((middle < low) | (middle > high)) < 2:
        return None
    known = [
        np.full(len(names), factor) for factor in (*KNOWN, *gears, *(1.0 / gear for gear in gears))
    ]
    known += [robot.reduction[index], 1.0 / robot.reduction[index]]
    fit = [factors for factors in known if _within(middle / factors, low, high)]
    return min(
        fit, key=lambda factors: float(np.sum((middle / factors - stand) ** 2)), default=None
    )


def _within(values: Floats, low: Floats, high: Floats) -> bool:
    return bool(np.all((values >= low) & (values <= high)))


def rate_slopes(
    time_s: Floats, q: Floats, dq: Floats, moving: float = MOVING, barely: float = BARELY
) -> NDArray[np.float64] | None:
    """Slopes of dq over the rate of q, shape (joints,), NaN at rest; None of a log too short.

    A rate of this RMS [rad/s] is compared, of the second already where dq shows the very motion of
    q. Errors of q, such as coarse steps, make the slope too small, and the inverse of that of the
    rate over dq too large: where both are of one motion, it is the one between them nearest to 1.
    """
    width = max(1, round(RATE_S / float(np.median(np.diff(time_s)))))
    if len(time_s) < 4 * width:
        return None
    rate = (q[width:] - q[:-width]) / (time_s[width:] - time_s[:-width])[:, None]
    mean = step_means(dq, width)
    tiny = np.finfo(np.float64).tiny
    power, product = np.maximum(np.sum(rate**2, axis=0), tiny), np.sum(rate * mean, axis=0)
    told = np.maximum(np.sum(mean**2, axis=0), tiny)
    alike = np.abs(product) / np.sqrt(power) / np.sqrt(told)
    size, least = np.sqrt(power / len(rate)), np.abs(product) / power
    most = np.where(alike > ONE_MOTION, told / np.maximum(np.abs(product), tiny), least)
    slope = np.sign(product) * np.clip(1.0, least, np.maximum(least, most))
    return np.where((size > moving) | ((alike > FOLLOWS) & (size > barely)), slope, np.nan)


def command_rate_faults(log: RunLog) -> Iterator[LogFault]:
    """Faults of dq_des that is the rate of q_des but for a factor that a unit has."""
    joints = log.joints
    if joints.dq_des is None or joints.q_des is None or not joints.dq_des.any():
        return
    slopes = rate_slopes(joints.time_s, joints.q_des, joints.dq_des, moving=np.inf, barely=0.0)
    if slopes is None:
        return
    factors = {joint: float(slope) for joint, slope in enumerate(slopes) if np.isfinite(slope)}
    off = {joint: factor for joint, factor in factors.items() if is_off(factor)}
    for where, factor in by_cause(log.meta["joints"], off) if len(off) > 0.5 * len(factors) else ():
        yield unit_fault(
            "wrong_rate",
            "dq_des",
            f"dq_des of {where}",
            factor,
            "the rate of q_des",
            gear_reductions(log),
        )
