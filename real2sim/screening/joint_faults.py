"""Faults of joint columns: units, signs, swapped names, wrong gains."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.optimize import linear_sum_assignment

from saltus.arrays import Floats
from saltus.real2sim.problem.log import claimed_model, gains_in_force, why_commands_unknown
from saltus.real2sim.screening import channel_scales
from saltus.real2sim.screening.angles import (
    BEYOND_LIMIT,
    angle_faults,
    command_rate_faults,
    posture_faults,
    rate_slopes,
)
from saltus.real2sim.screening.channel_scales import LogFault
from saltus.real2sim.screening.gains import angle_scale_faults, gain_faults
from saltus.real2sim.screening.gravity import feedforward_faults, gravity_faults
from saltus.recordings.run_log import JointTable, RunLog
from saltus.robots.robot import JOINTS, Robot

SLOW_S = 0.3  # moving average: a position-controlled leg follows what is left, below 1.5 Hz
MOVES = 0.1  # rad of slow command from which a joint must follow
FLIPPED = -0.7  # correlation of a joint with its slow command below which the sign is wrong
SWAP_GAIN = 3.0  # times closer to the command of another joint than to its own
SWAP_OFF = 0.15  # rad RMS: gravity and bias alone make smaller differences from the command
LEGS = 3  # smallest number of legs among which one can be the exception
STANCE_OFF, STANCE_LIKE = 0.6, 0.25  # rad: different kinds of joints stand at least 0.9 apart
# Slow response over slow command; gravity and gains off by 20 % stay within 0.85-1.15
RATIO_RANGE = (
    0.75,
    1.33,
)
RATIO_MOVES = 0.4  # rad: friction of 0.8 Nm takes 0.04 rad at kp 20
TURNS = 100  # parts of a log whose turns are compared, however long its rows are said to be
ALIKE = 0.7  # correlation of turns and velocities from which they are of one motion; noise has none
OTHER_UNIT = 240.0  # between degrees for rad (57) and ms for s (1000), the two errors that are made
FASTEST = 100.0  # rad/s RMS over a log: three times what a drive of this class reaches at its best
SLOWEST_ROW_S = 0.1  # a command that holds for longer steers no leg
TOO_FAST = 1.05  # same ratio: noise and filters only make dq smaller


def joint_faults(log: RunLog) -> list[LogFault]:
    """Faults of the columns of `joints`; later checks rely on earlier ones."""
    if log.joints.q_des is None:
        return [*unit_faults(log), *_limits(log), *_rates(log)]
    faults: list[LogFault] = []
    slow = _SlowMotion(log)
    for checks in (
        (_dead(log), unit_faults(log)),
        (_swapped(slow), _limits(log), _misnamed(slow)),
        (angle_scale_faults(log),),
        (_signs(slow), _ratio(slow), _rates(log), command_rate_faults(log)),
        (gain_faults(log),),
        (feedforward_faults(log),),
        (gravity_faults(log),),
    ):
        faults += chain.from_iterable(checks)
        if any(fault.is_fatal for fault in faults):
            break
    return faults


class _SlowMotion:
    """States and commands below 1.5 Hz, where a position-controlled joint follows its command."""

    def __init__(self, log: RunLog) -> None:
        self.joints: list[str] = log.meta["joints"]
        self.is_fixed = log.meta.get("base") == "fixed"
        width = max(1, round(SLOW_S / float(np.median(np.diff(log.joints.time_s)))))
        told = log.joints.commanded_q
        if not why_commands_unknown(log):  # a drive without stiffness follows no angle
            told = np.where(gains_in_force(log)[0] > 0.0, told, log.joints.q)
        # twice: a triangular window has small side lobes
        self.q, self.q_des = (
            uniform_filter1d(uniform_filter1d(values, width, axis=0), width, axis=0)
            for values in (log.joints.q, told)
        )
        self.moves = np.ptp(self.q_des, axis=0) > MOVES


def _dead(log: RunLog) -> Iterator[LogFault]:
    names = log.meta["joints"]
    joints = log.joints
    commanded = np.ptp(joints.commanded_q, axis=0) > MOVES
    moved = np.ptp(joints.q, axis=0) > MOVES
    for signal, told, but in (
        ("q", commanded, "it is commanded to move"),
        ("dq", moved, "q does; leave the columns out if nobody measured"),
        ("tau_est", moved, "q does; leave the columns out"),
    ):
        values = getattr(joints, signal)
        dead = (
            told & (np.ptp(values, axis=0) == 0) if values is not None else np.zeros(0, dtype=bool)
        )
        if dead.any():
            text = f"{signal} of {_list(names, dead)} never changes although {but}"
            yield LogFault(name="dead_channel", text=text)
    yield from _frozen(log.joints, names)


def _frozen(joints: JointTable, names: list[str]) -> Iterator[LogFault]:
    """A reading that stops while its command moves on by more than friction could hold."""
    rows = max(2, round(0.5 / float(np.median(np.diff(joints.time_s)))))
    if len(joints.q) <= rows:
        return
    still = np.abs(np.diff(joints.q, axis=0)) == 0
    count = uniform_filter1d(still.astype(float), rows, axis=0)
    for joint, name in enumerate(names):
        stopped = np.flatnonzero(count[:, joint] > 1 - 0.5 / rows)
        if not len(stopped):
            continue
        command = joints.commanded_q[stopped, joint]
        groups = np.split(command, np.flatnonzero(np.diff(stopped) > 1) + 1)
        if max(float(np.ptp(group)) for group in groups) > 3 * MOVES:
            yield LogFault(
                name="dead_channel",
                text=f"q of {name} stops for over 0.5 s while its command moves on",
            )


def unit_faults(log: RunLog) -> Iterator[LogFault]:
    """Faults of angles that no joint reaches, and of times that do not go with the motion."""
    found: list[LogFault] = []
    if log.joints.q_des is not None:
        slow = _SlowMotion(log)
        found += angle_faults(log, slow.q, slow.q_des)
    postures = list(posture_faults(log))
    # In a jump legs do not follow their angles: a scale that is no unit, of a few joints, is less
    # than angles that no joint of the robot reaches.
    if any(" of all joints " in fault.text for fault in postures) and all(
        channel_scales.UNKNOWN_UNIT in fault.text for fault in found
    ):
        found = postures
    yield from found or postures or _time_unit(log.joints)


def _time_unit(joints: JointTable) -> Iterator[LogFault]:
    """Times in another unit: joints then turn a thousand times too fast or too slow."""
    rows = max(1, len(joints.time_s) // TURNS)
    lasts = (joints.time_s[rows:] - joints.time_s[:-rows])[:, None]
    if not lasts.all():
        return  # stamps that stand still are a fault of their own
    turned = joints.q[rows:] - joints.q[:-rows]
    if joints.dq is not None:
        expected = channel_scales.step_means(joints.dq, rows) * lasts
        power, told = float(np.sum(turned**2)), float(np.sum(expected**2))
        is_one_motion = np.sum(turned * expected) > ALIKE * np.sqrt(power * told) > 0.0
        times = np.sqrt(told / power) if is_one_motion else 1.0
        if not 1.0 / OTHER_UNIT < times < OTHER_UNIT:
            text = f"by dq and t joints turn {times:.3g} times as far as q says: is t in seconds?"
            yield LogFault(name="time_unit", text=text)
            return
    speed = float(np.sqrt(np.mean((turned / lasts) ** 2)))
    row_s = float(np.median(np.diff(joints.time_s)))
    if speed > FASTEST:
        yield LogFault(
            name="time_unit", text=f"joints turn at {speed:.3g} rad/s on average: is t in seconds?"
        )
    elif row_s > SLOWEST_ROW_S:
        text = f"rows of joints are {row_s:.3g} s apart: too slow to steer a leg; is t in seconds?"
        yield LogFault(name="time_unit", text=text, is_fatal=False)


def _limits(log: RunLog) -> Iterator[LogFault]:
    """Joints of a known robot outside their range: names, signs or offsets are wrong."""
    names = log.meta["joints"]
    robot = claimed_model(log)
    if not isinstance(robot, Robot) or not set(names) <= set(JOINTS):
        return
    index = [JOINTS.index(name) for name in names]
    low, high = robot.joint_lower[index] - BEYOND_LIMIT, robot.joint_upper[index] + BEYOND_LIMIT
    middle = np.median(log.joints.q, axis=0)
    # a log of the camera may have joint columns that nobody measured
    wrong = (np.ptp(log.joints.q, axis=0) > MOVES) & ((middle < low) | (middle > high))
    if wrong.any():
        seen = ", ".join(f"{names[j]} at {middle[j]:.2f} rad" for j in np.flatnonzero(wrong)[:3])
        yield LogFault(
            name="out_of_range",
            text=f"joints stand where they cannot be ({seen}): wrong names, signs or zeros",
        )


def _swapped(slow: _SlowMotion) -> Iterator[LogFault]:
    """Pairs q and q_des by distance and compares with the pairing by names."""
    apart = np.sqrt(np.mean((slow.q[:, :, None] - slow.q_des[:, None, :]) ** 2, axis=0))
    _, best = linear_sum_assignment(apart**2)
    own = np.diag(apart)
    found = apart[np.arange(len(best)), best]
    moved = best != np.arange(len(best))
    wrong = moved & (own > SWAP_OFF) & (own > SWAP_GAIN * found)
    if wrong.any():
        pairs = ", ".join(
            f"q of {slow.joints[j]} follows q_des of {slow.joints[best[j]]}"
            for j in np.flatnonzero(wrong)
        )
        own_off, other_off = own[wrong].mean(), found[wrong].mean()
        yield LogFault(
            name="swapped_joints",
            text=f"{pairs} ({other_off:.2f} rad apart, {own_off:.2f} from its own)",
        )


def _misnamed(slow: _SlowMotion) -> Iterator[LogFault]:
    """A leg whose joints stand like other joints in the other legs:
    all its columns are misnamed.
    """
    legs: dict[str, list[int]] = {}
    for index, name in enumerate(slow.joints):
        legs.setdefault(name.split("_")[0], []).append(index)
    if len(legs) < LEGS or len({len(joints) for joints in legs.values()}) != 1:
        return
    stance = np.array([np.median(slow.q_des[:, joints], axis=0) for joints in legs.values()])
    for leg, joints in enumerate(legs.values()):
        others = np.median(np.delete(stance, leg, axis=0), axis=0)
        apart = np.abs(stance[leg][:, None] - others)
        own, found = np.diag(apart), apart.min(axis=1)
        wrong = (own > STANCE_OFF) & (found < STANCE_LIKE)
        if wrong.sum() >= 2:
            names = ", ".join(slow.joints[joints[j]] for j in np.flatnonzero(wrong))
            text = (
                f"{names} stand as other joints do in the other legs ({own[wrong].max():.2f} rad "
                "apart): wrong names"
            )
            yield LogFault(name="swapped_joints", text=text)


def _signs(slow: _SlowMotion) -> Iterator[LogFault]:
    correlation, _ = _follow(slow)
    wrong = slow.moves & (correlation < FLIPPED)
    if wrong.any():
        worst = correlation[wrong].min()
        text = (
            f"q of {_list(slow.joints, wrong)} moves against q_des (correlation {worst:.2f}): "
            "a sign is flipped"
        )
        yield LogFault(name="flipped_sign", text=text)


def _ratio(slow: _SlowMotion) -> Iterator[LogFault]:
    """A joint that follows with a constant factor:
    a gear or linkage ratio is counted twice or not at all.
    """
    correlation, slope = _follow(slow)
    low, high = RATIO_RANGE
    wrong = (
        (np.ptp(slow.q_des, axis=0) > RATIO_MOVES)
        & (correlation > 0.99)
        & ((slope < low) | (slope > high))
    )
    if slow.is_fixed and wrong.any():
        text = (
            f"q of {_list(slow.joints, wrong)} follows slow commands by {slope[wrong].mean():.2f}: "
            "a wrong gear ratio?"
        )
        yield LogFault(name="wrong_ratio", text=text)


def _follow(slow: _SlowMotion) -> tuple[Floats, Floats]:
    """Correlation and slope of the slow response on the slow command, per joint."""
    q, q_des = slow.q - slow.q.mean(axis=0), slow.q_des - slow.q_des.mean(axis=0)
    power, product = np.sum(q_des**2, axis=0), np.sum(q * q_des, axis=0)
    tiny = np.finfo(np.float64).tiny
    return product / np.sqrt(np.maximum(power * np.sum(q**2, axis=0), tiny)), product / np.maximum(
        power, tiny
    )


def _rates(log: RunLog) -> Iterator[LogFault]:
    """Compares dq with the rate of q."""
    if log.joints.dq is None:
        return
    names = log.meta["joints"]
    slopes = rate_slopes(log.joints.time_s, log.joints.q, log.joints.dq)
    if slopes is None:
        return
    wrong = {
        joint: float(slope)
        for joint, slope in enumerate(slopes)
        if np.isfinite(slope) and channel_scales.is_off(slope)
    }
    for where, factor in channel_scales.by_cause(names, wrong):
        fault = channel_scales.unit_fault(
            "wrong_rate",
            "dq",
            f"dq of {where}",
            factor,
            "the rate of q",
            channel_scales.gear_reductions(log),
        )
        yield replace(fault, name="wrong_rate")
    fast = np.nan_to_num(slopes) > TOO_FAST
    fast[list(wrong)] = False
    if fast.any():
        text = (
            f"dq of {_list(names, fast)} is {slopes[fast].mean():.2f} times the rate of q: "
            "no filter does that"
        )
        yield LogFault(name="fast_rate", text=text, is_fatal=False)


def _list(names: list[str], chosen: NDArray[np.bool_]) -> str:
    picked = [name for name, is_chosen in zip(names, chosen, strict=True) if is_chosen]
    return "all joints" if len(picked) == len(names) and len(names) > 1 else ", ".join(picked)
