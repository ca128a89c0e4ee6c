"""Drivers of residuals that are read from a run log, for `localise`."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.real2sim.problem.log import drive_torque, rates
from saltus.real2sim.problem.problem import Driver, Problem
from saltus.real2sim.reporting.localise import Channel
from saltus.recordings.run_log import RunLog

TIME = "time in the run"
"""Name of the driver that every residual has."""
SMOOTH_S = 0.02  # moving average before differentiation, which would amplify the noise of dq
REVERSAL_S = 0.05  # after a reversal: in this time backlash closes and friction changes sign
MOVING = 0.05  # rad/s, one sigma of dq: below it the direction is noise


def channels_of(
    problem: Problem, log: RunLog, residuals: Floats, chosen: NDArray[np.bool_] | None = None
) -> tuple[Channel, ...]:
    """Residuals of a problem, one channel for each signal of each block, with their drivers.

    Residuals, and the rows of them that are `chosen` (all by default), have the shape (blocks, m).
    """
    channels = []
    own = problem.drivers()
    counts = np.ones(residuals.shape, dtype=bool) if chosen is None else chosen
    for block, places in enumerate(problem.places):
        for index, name in enumerate(problem.signals):
            rows = np.flatnonzero((problem.signal == index) & counts[block])
            rows = rows[np.argsort(problem.time_s[rows], kind="stable")]
            if not len(rows):
                continue
            where = next((w for w in places if name.endswith(f"_{w}")), "")
            signal = name.removesuffix(f"_{where}") if where else name
            place = places[where] if where else problem.name
            seen = (replace(driver, values=driver.values[rows]) for driver in own)
            every = (*drivers_of(log, place, problem.time_s[rows]), *seen)
            drivers = tuple(driver for driver in every if np.isfinite(driver.values).all())
            channels.append(Channel(signal=signal, place=place, residual=residuals[block, rows], drivers=drivers))
    return tuple(channels)


def drivers_of(log: RunLog, place: str, time_s: Floats) -> tuple[Driver, ...]:
    """Drivers of a residual at a joint or another place, at given times."""
    drivers = [Driver(name="a constant", unit="", values=np.ones(len(time_s)))]
    if place in log.meta["joints"]:
        drivers += _joint_drivers(log, log.meta["joints"].index(place), time_s)
    drivers.append(Driver(name=TIME, unit="s", values=time_s - float(log.joints.time_s[0])))
    if log.base is not None:
        for name, unit, column in (("height", "m", 2), ("vertical speed", "m/s", 9)):
            values = _at(time_s, log.base.time_s, log.base.values[:, column])
            drivers.append(Driver(name=f"the base's {name}", unit=unit, values=values))
    return tuple(drivers)


def _joint_drivers(log: RunLog, joint: int, time_s: Floats) -> list[Driver]:
    joints = log.joints
    q, dq = joints.q[:, joint], rates(joints)[:, joint]
    torque = (drive_torque(log) if joints.tau_est is None else joints.tau_est)[
        :, joint
    ]  # what the drive believes, if known
    width = max(1, round(SMOOTH_S / float(np.median(np.diff(joints.time_s)))))
    smooth = np.convolve(dq, np.ones(width) / width, mode="same")
    direction = np.where(np.abs(smooth) > MOVING, np.sign(smooth), 0.0)
    turned = np.flatnonzero(np.diff(np.sign(smooth)) != 0)
    turns_s = np.concatenate([[-np.inf], joints.time_s[turned]])
    since = joints.time_s - turns_s[np.searchsorted(turns_s, joints.time_s, side="right") - 1]
    signals = (
        ("torque", "Nm", torque),
        ("velocity", "rad/s", dq),
        ("acceleration", "rad/s2", np.gradient(smooth, joints.time_s)),
        ("the direction of motion", "", direction),
        ("angle", "rad", q - np.nanmean(q)),
    )
    drivers = [Driver(name=n, unit=u, values=_at(time_s, joints.time_s, v)) for n, u, v in signals]
    turning = np.interp(time_s, joints.time_s, (since < REVERSAL_S).astype(np.float64))
    return [*drivers, Driver(name="just after reversals", unit="", values=turning, is_regime=True)]


def _at(time_s: Floats, times: Floats, values: Floats) -> Floats:
    """Interpolated values, across missing samples; NaN if all are missing."""
    known = np.isfinite(values)
    return np.interp(time_s, times[known], values[known]) if known.any() else np.full(len(time_s), np.nan)
