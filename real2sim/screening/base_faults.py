"""Faults of the columns of IMU and base: quaternions, units, axes."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations

import numpy as np
from scipy.spatial.transform import Rotation

from saltus.arrays import Floats, Indices
from saltus.constants import GRAVITY
from saltus.real2sim.problem.log import boxes_of, claimed_model, robot_of
from saltus.real2sim.screening.channel_scales import (
    LogFault,
    by_cause,
    is_off,
    likely_cause,
    step_means,
    unit_fault,
    unit_of,
)
from saltus.recordings.log_units import LENGTHS
from saltus.recordings.run_log import LogTable, RunLog
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import JOINTS, Robot
from saltus.rotations import rotation_matrix

UNIT_NORM = 0.01  # error of a quaternion's norm: four decimals in a text file make 1e-4
# Share of gravity in the mean acceleration: the ground gives a hopping robot all of it, in impacts
FREE_FALL = 0.3
HEAVY = 1.7  # times gravity: noise and impacts that a sensor cuts off leave the mean within a tenth
# Cosine between mean acceleration and up below which axes are wrong: 60 deg, biases are 2 deg
TILT = 0.5
MEAN_S = 0.2  # time over which a rate must equal the change of a pose: longer than any delay
CARRIED = 1.5  # times the usual time span: rows are missing in between
TURNS = (
    0.1  # rad/s RMS from which axes can be told from biases (0.05 at most; this much is forgiven)
)
MOVES = 0.05  # m/s RMS from which velocities are compared
SHOWN = 0.9  # correlation from which a rate shows the motion of its pose, whatever its unit is
BARELY = 0.2  # of `TURNS` and `MOVES`: from there on a rate that shows its pose is compared
STANDS = 0.3  # m: height of the trunk of a robot of this class
ROWS = 200  # poses whose height is compared, spread over the log
# Correlation below which turns and gyroscope are not of one motion: an axis of three may be flipped
ALIKE = 0.7
LEVEL = 0.01  # m RMS by which feet on level ground are apart in height, with joints 0.03 rad off
CLEARLY = 3.0  # times less in the right order, or frame
SMALLEST = 0.05  # share of all turns from which those of an axis are told
RANGE = (0.5, 2.0)  # ratio of a rate to the change of its pose
FAR = 5.0  # m: no base of a standing or jumping robot is higher above the ground


def pose_faults(log: RunLog) -> list[LogFault]:
    """Faults of `imu` and `base` that single rows show."""
    faults: list[LogFault] = []
    for name, table, first in (("imu", log.imu, 0), ("base", log.base, 3)):
        if table is not None:
            faults += _norm(name, table.values[:, first : first + 4])
    return faults


def rig_faults(log: RunLog) -> list[LogFault]:
    """Faults of `imu` and `base`."""
    faults = pose_faults(log)
    if faults:
        return faults
    if order := list(_order_by_gyro(log)) or list(_order_by_feet(log)):
        return order
    if log.imu is not None:
        faults += [*_gravity(log.imu), *_gyro(log.imu)]
    if log.base is not None:
        faults += _base(log, log.base)
    return faults


def _norm(name: str, quaternions: Floats) -> Iterator[LogFault]:
    norms = np.linalg.norm(quaternions, axis=1)
    wrong = np.abs(norms - 1) > UNIT_NORM
    if wrong.any():
        text = (
            f"{name}: {wrong.mean():.1%} of the quaternions are no rotations, "
            f"their norms reach {norms[wrong][0]:.3g}"
        )
        yield LogFault(name="quaternion_norm", text=text)


def _order_by_gyro(log: RunLog) -> Iterator[LogFault]:
    """Quaternions that turn as the gyroscope does only where they are read as x, y, z, w."""
    if log.imu is None:
        return
    imu = log.imu
    for name, table, first in (("imu", log.imu, 0), ("base", log.base, 3)):
        if table is None:
            continue
        gyro = np.column_stack(
            [np.interp(table.time_s, imu.time_s, imu.values[:, axis]) for axis in (4, 5, 6)]
        )
        alike = []
        for last in (0, 1):
            quaternions = np.roll(table.values[:, first : first + 4], last, axis=1)
            turn, mean = _turns(table.time_s, quaternions, gyro)
            size = np.sqrt(float(np.sum(turn**2) * np.sum(mean**2)))
            alike.append(float(np.sum(turn * mean)) / size if size > 0.0 else 0.0)
        if alike[0] < ALIKE < alike[1] and _is_upright(
            np.roll(table.values[:, first : first + 4], 1, axis=1)
        ):
            yield _wrong_order(name, "only so does it turn as the gyroscope does")


def _order_by_feet(log: RunLog) -> Iterator[LogFault]:
    """A wrong order of the quaternion, told on level ground by the feet that stand."""
    if log.base is None or (standing := _feet(log, log.base)) is None:
        return
    feet, rows = standing
    spread = []
    for last in (0, 1):
        turned = feet @ rotation_matrix(np.roll(log.base.values[rows, 3:7], last, axis=1)).swapaxes(
            -1, -2
        )
        spread.append(float(np.sqrt(np.mean(np.var(turned[..., 2], axis=1)))))
    upright = _is_upright(np.roll(log.base.values[:, 3:7], 1, axis=1))
    if upright and spread[1] < LEVEL and spread[0] > CLEARLY * spread[1]:
        text = (
            f"only so do its feet stand {1e3 * spread[1]:.2g} mm apart in height, and not "
            f"{1e3 * spread[0]:.2g}"
        )
        yield _wrong_order("base", text)


def _is_upright(quaternions: Floats) -> bool:
    """Tells a wrong order from a gyroscope with flipped signs,
    beside which robots would hang upside down.
    """
    return float(np.median(rotation_matrix(quaternions)[:, 2, 2])) > TILT


def _wrong_order(name: str, why: str) -> LogFault:
    text = f"{name}: the quaternions are in the order x, y, z, w ({why}): write them as w, x, y, z"
    return LogFault(name="quaternion_order", text=text)


def _gravity(imu: LogTable) -> Iterator[LogFault]:
    acceleration = imu.values[:, 7:10]
    mean = _rotation(imu.values[:, :4]).apply(acceleration).mean(axis=0)
    size = float(np.linalg.norm(mean))
    factor = size / GRAVITY * (-1.0 if mean[2] < -TILT * size else 1.0)
    told = f"imu: acc is {factor:.4g} times gravity on average ({size:.4g} m/s2 for {GRAVITY:g})"
    if FREE_FALL < abs(factor) < HEAVY:
        if mean[2] / size < TILT:
            up = np.round(mean / size, 2).tolist()
            why = "a sign is flipped, " if factor < 0.0 else ""
            text = (
                f"{told} and points along {up} in the world, not up: "
                f"{why}wrong axes or quaternion order"
            )
            yield LogFault(name="imu_axes", text=text)
        return
    # if gravity was taken out, the mean is noise in every unit, and the other columns are still
    # useful
    spread = float(np.std(acceleration, axis=0).max())
    is_twice = bool(unit_of("acc", 1.0 / max(abs(factor), 1e-9))) and size > spread
    is_unit = bool(unit_of("acc", abs(factor))) or abs(factor) > HEAVY or is_twice
    said = likely_cause("acc", factor) if is_unit else "was gravity taken out?"
    yield LogFault(name="acceleration_unit", text=f"{told}: {said}", is_fatal=is_unit)


def _gyro(imu: LogTable) -> Iterator[LogFault]:
    turn, gyro = _turns(imu.time_s, imu.values[:, :4], imu.values[:, 4:7])
    if order := _order_of_axes(turn, gyro):
        text = f"imu: gyro {order}: the columns, or those of the quaternion, are of other axes"
        yield LogFault(name="imu_axes", text=text)
        return
    yield from _compare("imu", "gyro", "orientation", turn, gyro, TURNS)


def _order_of_axes(turn: Floats, gyro: Floats) -> str:
    """Says whose turns each axis of a gyroscope shows, "" where that is its own."""
    one, other = gyro - gyro.mean(axis=0), turn - turn.mean(axis=0)
    alike = one.T @ other / np.sqrt(max(np.sum(one**2) * np.sum(other**2), 1e-12))
    seen = {order: sum(abs(alike[range(3), order])) for order in permutations(range(3))}
    best = max(permutations(range(3)), key=lambda order: round(seen[order], 6))
    if seen[0, 1, 2] > ALIKE or seen[best] < SHOWN:
        return ""
    shares = [float(alike[axis, best[axis]]) for axis in range(3)]
    return " and ".join(
        f"{'xyz'[axis]} shows turns about {'-' if share < 0.0 else ''}{'xyz'[best[axis]]}"
        for axis, share in enumerate(shares)
        if best[axis] != axis and abs(share) > SMALLEST
    )


def _turns(time_s: Floats, quaternions: Floats, gyro: Floats) -> tuple[Floats, Floats]:
    """Mean angular velocity in the body frame over time spans,
    from orientation and from gyroscope.
    """
    rows = _span(time_s)
    rotations = _rotation(quaternions)
    steps_s = (time_s[rows:] - time_s[:-rows])[:, None]
    turn = (rotations[:-rows].inv() * rotations[rows:]).as_rotvec() / steps_s
    return turn, step_means(gyro, rows)


def _base(log: RunLog, base: LogTable) -> Iterator[LogFault]:
    height = float(np.median(base.values[:, 2]))
    boxes = boxes_of(log)
    tops = [0.0, *(boxes.center + boxes.half_size)[:, 2]]
    if not min(tops) - FAR < height < max(tops) + FAR:
        factor = _length_factor(height)
        text = (
            f"base: position is {factor:.4g} times what it can be: z is {height:.4g}, more than "
            f"{FAR:.0f} m off the "
        )
        yield LogFault(name="base_unit", text=f"{text}ground; {likely_cause('position', factor)}")
        return
    yield from _stands(log, base)
    rows = _span(base.time_s)
    steps_s = (base.time_s[rows:] - base.time_s[:-rows])[:, None]
    change = (base.values[rows:, :3] - base.values[:-rows, :3]) / steps_s
    # a robot that is carried while nothing is recorded moves without a velocity
    whole = steps_s[:, 0] < CARRIED * np.median(steps_s)
    mean = step_means(base.values[:, 7:10], rows)
    turned = step_means(_rotation(base.values[:, 3:7]).apply(base.values[:, 7:10]), rows)
    left, left_turned = (
        float(np.sqrt(np.mean((each - change)[whole] ** 2))) for each in (mean, turned)
    )
    if left > BARELY * MOVES and CLEARLY * left_turned < left:
        text = (
            "base: velocity is in the frame of the base (it differs from the change of position by "
            f"{left:.2g} m/s, turned into the world by {left_turned:.2g}): turn it into the world"
        )
        yield LogFault(name="base_frame", text=text)
        return
    yield from _compare("base", "velocity", "position", change[whole], mean[whole], MOVES)


def _length_factor(height: float) -> float:
    """The factor of a length that brings a base nearest to the height of a standing robot."""
    factors = [1.0 / metres for name, metres in LENGTHS.items() if name != "m"]
    return min(factors, key=lambda factor: abs(np.log(max(abs(height), 1e-9) / factor / STANDS)))


def _stands(log: RunLog, base: LogTable) -> Iterator[LogFault]:
    """A base whose height is in a unit other than that of its legs, on flat ground."""
    standing = _feet(log, base)
    if standing is None or len(boxes_of(log).center):
        return
    robot, (feet, rows) = robot_of(log), standing
    turned = feet @ rotation_matrix(base.values[rows, 3:7]).swapaxes(-1, -2)
    legs = robot.foot_radius - turned[..., 2].min(axis=1)
    factor = float(np.median(base.values[rows, 2] / legs))
    if is_off(factor) and (
        unit_of("position", factor) or (factor > 0.0 and unit_of("position", 1.0 / factor))
    ):
        yield unit_fault(
            "base_unit", "position", "base: position", factor, "the height on its legs"
        )


def _feet(log: RunLog, base: LogTable) -> tuple[Floats, Indices] | None:
    """Feet in the base frame [m], shape (rows, 4, 3), and rows of the base; None if none stand."""
    names = tuple(name.removesuffix("_joint") for name in log.meta["joints"])
    robot = claimed_model(log)
    if log.meta.get("base") == "fixed" or names != JOINTS or not isinstance(robot, Robot):
        return None
    if not np.ptp(log.joints.q, axis=0).any():
        return None  # nobody measured the joints
    rows = np.unique(np.linspace(0, len(base.time_s) - 1, ROWS).astype(int))
    near = np.clip(
        np.searchsorted(log.joints.time_s, base.time_s[rows]), 0, len(log.joints.time_s) - 1
    )
    return np.asarray(LegKinematics(robot).position(log.joints.q[near])), rows


def _compare(
    table: str, rate: str, pose: str, change: Floats, mean: Floats, seen: float
) -> Iterator[LogFault]:
    """Compares each axis of a rate with the change of its pose.

    A bias of the rate below `seen` is no fault.
    """
    if not len(change):
        return
    power = np.sum(change**2, axis=0)
    bias = np.clip(np.mean(mean - change, axis=0), -seen, seen)
    slope = np.sum(change * (mean - bias), axis=0) / np.maximum(power, 1e-12)
    size = np.sqrt(power / len(change))
    shown = np.array(
        [_correlation(own, told) > SHOWN for own, told in zip(change.T, mean.T, strict=True)]
    )
    # what is off by a unit has no bias to speak of beside its motion
    centred, around = change - change.mean(axis=0), mean - mean.mean(axis=0)
    own = np.sum(centred * around, axis=0) / np.maximum(np.sum(centred**2, axis=0), 1e-12)
    wrong = ((size > seen) | (shown & (size > BARELY * seen))) & (
        (slope < RANGE[0]) | (slope > RANGE[1])
    )
    factors = np.where(shown, own, slope)
    for axes, factor in by_cause(
        "xyz", {axis: float(factors[axis]) for axis in range(3) if wrong[axis]}
    ):
        where = f"{table}: {rate} {axes.replace('all joints', 'x, y, z')}"
        fault = unit_fault("wrong_rate", rate, where, factor, f"the change of {pose}")
        other = unit_of(pose, 1.0 / factor) if pose == "position" and factor > 0.0 else ""
        text = (
            f"{fault.text}; or position in {other} ({1.0 / factor:.4g})?" if other else fault.text
        )
        yield replace(fault, name="wrong_rate", text=text)


def _correlation(one: Floats, other: Floats) -> float:
    """Factor between two motions without their means, as a size."""
    a, b = one - one.mean(), other - other.mean()
    return float(
        abs(np.sum(a * b)) / np.sqrt(max(np.sum(a**2) * np.sum(b**2), np.finfo(np.float64).tiny))
    )


def _span(time_s: Floats) -> int:
    return max(1, min(len(time_s) // 4, round(MEAN_S / float(np.median(np.diff(time_s))))))


def _rotation(quaternions: Floats) -> Rotation:
    return Rotation.from_quat(quaternions, scalar_first=True)
