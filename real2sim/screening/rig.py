"""Faults of the columns of IMU and base: quaternions, units, axes."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from saltus.arrays import Floats
from saltus.constants import GRAVITY
from saltus.real2sim.problem.log import boxes_of
from saltus.real2sim.screening.fault import Fault
from saltus.real2sim.screening.rates import means
from saltus.recordings.run_log import RunLog, Table

UNIT_NORM = 0.01  # error of a quaternion's norm: four decimals in a text file make 1e-4
FREE_FALL = 0.3  # share of gravity in the mean acceleration: the ground gives a hopping robot all of it, in impacts
G_UNIT = 0.3
TILT = 0.5  # cosine between mean acceleration and up below which axes are wrong: 60 deg, biases are 2 deg
MEAN_S = 0.2  # time over which a rate must equal the change of a pose: longer than any delay
CARRIED = 1.5  # times the usual time span: rows are missing in between
TURNS = 0.1  # rad/s RMS from which axes can be told from biases (0.05 at most; this much is forgiven)
MOVES = 0.05  # m/s RMS from which velocities are compared
RANGE = (0.5, 2.0)  # ratio of a rate to the change of its pose
FAR = 5.0  # m: no base of a standing or jumping robot is higher above the ground


def pose_faults(log: RunLog) -> list[Fault]:
    """Faults of `imu` and `base` that single rows show."""
    faults: list[Fault] = []
    for name, table, first in (("imu", log.imu, 0), ("base", log.base, 3)):
        if table is not None:
            faults += _norm(name, table.values[:, first : first + 4])
    return faults


def rig_faults(log: RunLog) -> list[Fault]:
    """Faults of `imu` and `base`."""
    faults = pose_faults(log)
    if faults:
        return faults
    if log.imu is not None:
        faults += [*_gravity(log.imu), *_gyro(log.imu)]
    if log.base is not None:
        faults += _base(log, log.base)
    return faults


def _norm(name: str, quaternions: Floats) -> Iterator[Fault]:
    norms = np.linalg.norm(quaternions, axis=1)
    wrong = np.abs(norms - 1) > UNIT_NORM
    if wrong.any():
        text = (
            f"{name}: {wrong.mean():.1%} of the quaternions are no rotations, their norms reach {norms[wrong][0]:.3g}"
        )
        yield Fault(name="quaternion_norm", text=text)


def _gravity(imu: Table) -> Iterator[Fault]:
    acceleration = imu.values[:, 7:10]
    mean = _rotation(imu.values[:, :4]).apply(acceleration).mean(axis=0)
    size = float(np.linalg.norm(mean))
    if size < FREE_FALL * GRAVITY:
        text = f"imu: the mean acceleration is {size:.3g} m/s2, gravity should make it {GRAVITY:g}: taken out, or in g?"
        # in units of g it is 1; if gravity was removed, the other columns are still useful
        is_g = abs(float(np.linalg.norm(acceleration, axis=1).mean()) - 1) < G_UNIT
        yield Fault(name="acceleration_unit", text=text, is_fatal=is_g)
    elif mean[2] / size < TILT:
        up = np.round(mean / size, 2).tolist()
        text = f"imu: the mean acceleration points along {up} in the world, not up: wrong axes or quaternion order"
        yield Fault(name="imu_axes", text=text)


def _gyro(imu: Table) -> Iterator[Fault]:
    turn, gyro = _turns(imu.time_s, imu.values[:, :4], imu.values[:, 4:7])
    yield from _compare("imu", "gyro", "orientation", turn, gyro, TURNS)


def _turns(time_s: Floats, quaternions: Floats, gyro: Floats) -> tuple[Floats, Floats]:
    """Mean angular velocity in the body frame over time spans, from orientation and from gyroscope."""
    rows = _span(time_s)
    rotations = _rotation(quaternions)
    steps_s = (time_s[rows:] - time_s[:-rows])[:, None]
    turn = (rotations[:-rows].inv() * rotations[rows:]).as_rotvec() / steps_s
    return turn, means(gyro, rows)


def _base(log: RunLog, base: Table) -> Iterator[Fault]:
    height = float(np.median(base.values[:, 2]))
    tops = [box["center"][2] + 0.5 * box["size"][2] for box in boxes_of(log.meta)]
    if not min([0.0, *tops]) - FAR < height < max([0.0, *tops]) + FAR:
        yield Fault(
            name="base_unit", text=f"base: z is {height:.4g}: more than {FAR:.0f} m off the ground; millimetres?"
        )
        return
    rows = _span(base.time_s)
    steps_s = (base.time_s[rows:] - base.time_s[:-rows])[:, None]
    change = (base.values[rows:, :3] - base.values[:-rows, :3]) / steps_s
    # a robot that is carried while nothing is recorded moves without a velocity
    whole = steps_s[:, 0] < CARRIED * np.median(steps_s)
    mean = means(base.values[:, 7:10], rows)
    yield from _compare("base", "velocity", "position", change[whole], mean[whole], MOVES)


def _compare(table: str, rate: str, pose: str, change: Floats, mean: Floats, seen: float) -> Iterator[Fault]:
    """Compares each axis of a rate with the change of its pose; a bias of the rate below `seen` is no fault."""
    power = np.sum(change**2, axis=0)
    bias = np.clip(np.mean(mean - change, axis=0), -seen, seen)
    slope = np.sum(change * (mean - bias), axis=0) / np.maximum(power, 1e-12)
    wrong = (np.sqrt(power / len(change)) > seen) & ((slope < RANGE[0]) | (slope > RANGE[1]))
    for axis in np.flatnonzero(wrong):
        text = f"{table}: {rate} {'xyz'[axis]} is {slope[axis]:.3g} times the change of {pose}: unit, sign or axis"
        yield Fault(name="wrong_rate", text=text)


def _span(time_s: Floats) -> int:
    return max(1, min(len(time_s) // 4, round(MEAN_S / float(np.median(np.diff(time_s))))))


def _rotation(quaternions: Floats) -> Rotation:
    return Rotation.from_quat(quaternions, scalar_first=True)
