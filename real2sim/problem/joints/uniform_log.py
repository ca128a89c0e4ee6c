"""From a run log to what a replay of its joints needs:
uniform instants, commands, the legs' equation of motion.
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from saltus.arrays import Floats, Indices
from saltus.effects.effect import map_arrays
from saltus.errors import ModelError, RecordingError
from saltus.real2sim.problem.joints.joint_mechanics import HeldJointMotion
from saltus.real2sim.problem.joints.replay import JointWindows, LoggedMotion
from saltus.recordings.run_log import RunLog
from saltus.sim.held_robot import HeldRobot, LinearLegs

SLOWEST_LOOP_S = 0.002
"""Drives evaluate their law at 500 Hz or faster (schema of run logs)."""
GAP_ROWS = 2.5
"""Rows that are further apart than this many periods part a log into stretches."""
JITTER = 0.1  # of a period: rows nearer than this to a uniform grid lie on it
SMOOTHING_S = 0.022
"""Around a row, for the motion near which the legs are linearised: what is left is noise, to second
order harmless."""
LINEARISED_EVERY_S = 0.008
"""Between evaluations of how the legs answer to a difference from the motion: a tenth of the period
of 10 Hz."""
START_S = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Stretches around a window's start from which the state there is estimated; the longest that is
still a parabola."""
WARM_UP_S = 0.25
"""After the start of a window: e^-3 of an error of its start is left under usual gains, and delays
are over."""
WINDOW_S = 1.0
"""Restarts this often cost a fifth more of simulated time, and a quarter less of computing: arrays
are larger."""


@dataclass(frozen=True, kw_only=True, eq=False)
class UniformLog:
    """A log on uniform rows, in stretches without gaps; arrays of shape (rows, joints)."""

    dt_s: float
    time_s: Floats
    """Shape (rows,)."""
    stretches: tuple[tuple[int, int], ...]
    """First row and end of each."""
    q: Floats
    """Interpolated where it is missing."""
    q_is_known: NDArray[np.bool_]
    q_des: Floats
    dq_des: Floats
    tau_ff: Floats
    dq: Floats | None
    tau_est: Floats | None

    @property
    def speed(self) -> Floats:
        """Measured velocities, or the change of the angles [rad/s]."""
        return self.dq if self.dq is not None else np.gradient(self.q, self.dt_s, axis=0)


def uniform_rows(log: RunLog) -> UniformLog:
    """Puts a log's rows on a uniform grid: states are interpolated, commands held.

    A log must fill one window.

    Raises:
        RecordingError: fewer rows than a window needs.
    """
    table = log.joints
    periods = np.diff(table.time_s)
    dt = float(np.median(periods)) if len(periods) else 0.0
    if len(table.time_s) * dt < 2.0 * WARM_UP_S:
        raise RecordingError(f"the log has {len(table.time_s)} rows of joints: too few to replay")
    cuts = np.flatnonzero(periods > GAP_ROWS * dt) + 1
    edges = [0, *cuts.tolist(), len(table.time_s)]
    parts, stretches, times, first = [], [], [], 0
    for a, b in itertools.pairwise(edges):
        if (b - a) * dt < 2.0 * WARM_UP_S:
            continue
        own = table.time_s[a:b]
        grid = own[0] + dt * np.arange(round((own[-1] - own[0]) / dt) + 1)
        parts.append((slice(a, b), grid))
        times.append(grid)
        stretches.append((first, first + len(grid)))
        first += len(grid)

    def put(values: Floats | None, *, held: bool) -> Floats | None:
        if values is None:
            return None
        return np.concatenate(
            [_on_grid(table.time_s[s], values[s], grid, dt, held=held) for s, grid in parts]
        )

    zeros = np.zeros((first, table.q.shape[1]))
    q, q_des = (
        put(_whole(table.time_s, table.q), held=False),
        put(_whole(table.time_s, table.commanded_q), held=True),
    )
    assert q is not None  # noqa: S101 - a log always has both
    assert q_des is not None  # noqa: S101
    dq_des, tau_ff = put(table.dq_des, held=True), put(table.tau_ff, held=True)
    return UniformLog(
        dt_s=dt,
        time_s=np.concatenate(times),
        stretches=tuple(stretches),
        q=q,
        q_is_known=np.isfinite(put(table.q, held=True)),  # type: ignore[arg-type]
        q_des=q_des,
        dq_des=zeros if dq_des is None else dq_des,
        tau_ff=zeros if tau_ff is None else tau_ff,
        dq=put(table.dq, held=False),
        tau_est=put(table.tau_est, held=False),
    )


def motions_of(
    rows: UniformLog, robot: HeldRobot, kp: Floats, kd: Floats
) -> tuple[LoggedMotion, LoggedMotion]:
    """The motion of a log for a replay, and the same motion with instants twice as close.

    The gains `kp` [Nm/rad] and `kd` [Nm s/rad] have the shape (joints,).
    """
    every = max(1, int(np.ceil(rows.dt_s / SLOWEST_LOOP_S - 1e-6)))
    legs, sway = _legs(rows, robot), _sway(rows, robot)
    coarse, fine = (_motion(rows, robot, (kp, kd), legs, sway, times * every) for times in (1, 2))
    return coarse, fine


def _motion(
    rows: UniformLog,
    robot: HeldRobot,
    gains: tuple[Floats, Floats],
    legs: LinearLegs,
    sway: HeldJointMotion | None,
    every: int,
) -> LoggedMotion:
    (kp, kd), branches = gains, robot.branches
    mass, offset, stiffness, damping = (
        _halfway(values, rows.stretches, every)
        for values in (legs.mass, legs.offset, legs.stiffness, legs.damping)
    )
    dt = rows.dt_s / every
    # the midpoint rule: all that resists is taken halfway to the next instant
    mass = mass + 0.5 * dt * damping
    damping = damping + 0.5 * dt * stiffness
    law = kp * rows.q_des + kd * rows.dq_des
    elapsed = (rows.time_s - rows.time_s[0]) / (rows.time_s[-1] - rows.time_s[0])
    return LoggedMotion(
        dt_s=dt,
        every=every,
        law=np.repeat(law[:, branches], every, axis=0),
        feedforward=np.repeat(rows.tau_ff[:, branches], every, axis=0),
        kp=kp[branches],
        kd=kd[branches],
        inverse_mass=np.asarray(np.linalg.inv(mass)),
        offset=offset,
        feedback=np.concatenate([stiffness, damping], axis=-1),
        armature=robot.armature[branches],
        elapsed=np.repeat(elapsed, every),
        sway=sway,
    )


def _sway(rows: UniformLog, robot: HeldRobot) -> HeldJointMotion | None:
    """How the base answers if it gives way; None where it is not known all that hangs from it."""
    motions = [_smooth(rows, *stretch) for stretch in rows.stretches]
    try:
        base = robot.rolling(*(np.concatenate(part) for part in zip(*motions, strict=True)))
    except ModelError:
        return None
    halfway = map_arrays(lambda values: _halfway(values, rows.stretches, 1), base)
    return HeldJointMotion(base=halfway, dt_s=rows.dt_s, stretches=rows.stretches)


def windows_of(rows: UniformLog, branches: Indices, every: int, averaged: int) -> JointWindows:
    """Windows that tile every stretch after its warm-up,
    each a multiple of `averaged` rows long.
    """
    warm = round(WARM_UP_S / rows.dt_s)
    length = max(1, round(WINDOW_S / (averaged * rows.dt_s))) * averaged
    found = [
        (start, begin, end - 1)
        for begin, end in rows.stretches
        for start in range(begin, end - warm - averaged + 1, length)
    ]
    states = [_state(rows, *window) for window in found]
    start, first, last = np.array(found).T * every
    return JointWindows(
        start=start,
        first=first,
        last=last + every - 1,
        warm_up=warm * every,
        length=length * every,
        position=np.array([q for q, _ in states])[:, branches],
        velocity=np.array([dq for _, dq in states])[:, branches],
    )


def twice_as_fine(windows: JointWindows) -> JointWindows:
    """A copy of windows counted in instants that are twice as close."""
    return replace(
        windows,
        start=2 * windows.start,
        first=2 * windows.first,
        last=2 * windows.last + 1,
        warm_up=2 * windows.warm_up,
        length=2 * windows.length,
    )


def _whole(time_s: Floats, values: Floats) -> Floats:
    """Values with what is missing interpolated, for who needs some value everywhere."""
    if np.isfinite(values).all():
        return values
    known = [np.isfinite(column) & np.isfinite(time_s) for column in values.T]
    return np.stack(
        [
            np.interp(time_s, time_s[k], column[k])
            for k, column in zip(known, values.T, strict=True)
        ],
        axis=1,
    )


def _on_grid(time_s: Floats, values: Floats, grid: Floats, dt_s: float, *, held: bool) -> Floats:
    if len(grid) == len(time_s) and np.max(np.abs(grid - time_s)) < JITTER * dt_s:
        return values
    if held:
        return values[
            np.clip(np.searchsorted(time_s, grid + JITTER * dt_s, side="right") - 1, 0, None)
        ]
    return np.stack([np.interp(grid, time_s, column) for column in values.T], axis=1)


def _legs(rows: UniformLog, robot: HeldRobot) -> LinearLegs:
    """The equation of motion at every row."""
    every = max(1, int(LINEARISED_EVERY_S / rows.dt_s))
    legs: LinearLegs = map_arrays(
        lambda *parts: np.concatenate(parts),
        *(robot.along(*_smooth(rows, *stretch), every) for stretch in rows.stretches),
    )
    return legs


def _smooth(rows: UniformLog, begin: int, end: int) -> tuple[Floats, Floats, Floats]:
    """Angles of a stretch, velocities and accelerations."""
    size = max(5, 2 * int(0.5 * SMOOTHING_S / rows.dt_s) + 1)
    q = savgol_filter(rows.q[begin:end], size, 3, axis=0)
    # not the measured velocity: a drive may have filtered it
    dq = savgol_filter(rows.q[begin:end], size, 3, deriv=1, delta=rows.dt_s, axis=0)
    return q, dq, np.gradient(dq, rows.dt_s, axis=0)


def _halfway(values: Floats, stretches: tuple[tuple[int, int], ...], every: int) -> Floats:
    """Values at rows, interpolated to halfway between instants, `every` a row."""
    parts = []
    for begin, end in stretches:
        at = np.minimum((np.arange((end - begin) * every) + 0.5) / every, end - begin - 1.0)
        left = np.minimum(at.astype(np.int64), end - begin - 2)
        weight = (at - left).reshape(-1, *(1,) * (values.ndim - 1))
        own = values[begin:end]
        parts.append((1.0 - weight) * own[left] + weight * own[left + 1])
    return np.concatenate(parts)


def _state(rows: UniformLog, row: int, first: int, last: int) -> tuple[Floats, Floats]:
    """Angles and velocities at a row: parabolas through the
    longest stretch around it that they fit.
    """
    noise = _noise(rows.q[max(first, row - 250) : min(last, row + 250)])
    q, dq = np.empty((2, rows.q.shape[1]))
    settled = np.zeros(rows.q.shape[1], dtype=bool)
    for i, span in enumerate(START_S):
        half = max(3, int(0.5 * span / rows.dt_s))
        around = np.arange(max(first, row - half), min(last, row + half) + 1)
        t = (around - row) * rows.dt_s
        powers = np.stack([np.ones_like(t), t, t**2], axis=1)
        fit, _, _, _ = np.linalg.lstsq(powers, rows.q[around], rcond=None)
        spread = np.std(rows.q[around] - powers @ fit, axis=0)
        fits = ~settled & ((spread < 1.1 * noise) | (i == 0))
        q[fits], dq[fits] = fit[0, fits], fit[1, fits]
        if rows.dq is not None:
            speed, _, _, _ = np.linalg.lstsq(powers, rows.dq[around], rcond=None)
            dq[fits] = speed[0, fits]
        settled |= ~fits
    return q, dq


def _noise(values: Floats) -> Floats:
    """Standard deviation of white noise on smooth signals, shape (rows, joints) -> (joints,).

    It follows from third differences, whose variance is 20 times that of the noise.
    """
    return np.median(np.abs(np.diff(values, n=3, axis=0)), axis=0) / (0.6745 * np.sqrt(20.0))
