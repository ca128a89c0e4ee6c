"""Effects that a log of joints cannot show, how far its motion goes,
and the steps of its encoders.
"""

from collections.abc import Sequence

import numpy as np
from scipy.signal import zoom_fft

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.joints.candidates import LogRange
from saltus.real2sim.problem.joints.uniform_log import UniformLog
from saltus.recordings.run_log import RunLog
from saltus.sim.held_robot import HeldRobot

LEAST_TORQUE = (
    5.0  # Nm commanded: drives of this class lose nothing below it (original's dynamometer table)
)
LEAST_FAST = (
    2.0  # rad/s: a tenth of the smallest no-load speed that is published for robots of this class
)
LEAST_SPEED = 0.05  # rad/s: below it a joint stands still
# Rad from a claimed limit: soft stops were found to begin 0.09 rad before it, see `EndStop`
NEAR_STOP = 0.2
LEAST_SAG_S = 5.0  # a battery does not empty in less
FINEST_STEP, COARSEST_STEP = 5e-4, 0.04
"""Steps of an encoder that are looked for [rad]: finer ones drown in noise of 1 mrad, coarser ones
no drive has."""
BIN = 5e-5
"""Width of a bin in the histogram of angles [rad]: a tenth of the finest step."""
LEAST_SPREADS = 6.0
"""Spreads of a spectrum by which a step must stand out: of 20000 values noise reaches 4.3."""
LEAST_SCORE = 0.1
"""Smallest mean of cos(2 pi angle / step) that tells a step: angles that are multiples of it up to
noise of a third of it still reach this mean."""
PARTS, TELLING = 4, 3
"""A step shows in three of four parts of the moving rows: a joint at a constant speed that is read
at equal times stays near multiples of an angle, too, as long as that motion lasts."""
LEAST_MOVING = 0.3  # rad/s: a joint that is faster passes a step of 5 mrad in 8 rows
LEAST_ROWS = 500  # that move: a second
LINES = 8
"""Number of lines of the spectrum in a band as wide as one over the largest angle: phases are then
good to 0.4 rad."""
REFINED = 201  # steps between two lines of the spectrum
SAME_STEP = 0.01
MOST_STEPS = 3
MOST = 0.9995  # quantile that counts as the largest: noise has outliers
NO_VOLTAGE = "it couples all joints by the battery, whose voltage no log holds"


def untestable_effects(log: RunLog, rows: UniformLog, reach: Sequence[LogRange]) -> dict[str, str]:
    """Effects that this log cannot show, and why."""
    torque, speed = max(r.torque for r in reach), max(r.speed for r in reach)
    why: dict[str, str] = {}
    if log.joints.tau_ff is None:
        why["feedforward_delay"] = "the log has no tau_ff"
    elif np.max(np.ptp(rows.tau_ff, axis=0)) < 1e-6:
        why["feedforward_delay"] = "tau_ff never changes"
    to_limit = min(r.to_limit for r in reach)
    if to_limit > NEAR_STOP:
        why["end_stop"] = f"no joint comes nearer than {to_limit:.2f} rad to its claimed limits"
    if log.joints.dq is None:
        why["velocity_scale"] = "the log has no dq: it would look like viscous friction"
    if torque < LEAST_TORQUE:
        why["torque_saturation"] = f"max |tau| commanded {torque:.1f} < {LEAST_TORQUE:g} Nm"
    if speed < LEAST_FAST:
        why["torque_speed_limit"] = f"max |dq| {speed:.1f} < {LEAST_FAST:g} rad/s"
    if speed < LEAST_SPEED:
        for effect in (
            "viscous_friction",
            "coulomb_friction",
            "stiction",
            "armature",
            "velocity_filter",
            "velocity_scale",
        ):
            why[effect] = f"max |dq| {speed:.3f} < {LEAST_SPEED:g} rad/s: nothing moves"
    why["voltage_sag"] = NO_VOLTAGE
    if rows.time_s[-1] - rows.time_s[0] < LEAST_SAG_S:
        why["battery_sag"] = (
            f"the log lasts {rows.time_s[-1] - rows.time_s[0]:.1f} < {LEAST_SAG_S:g} s"
        )
    return why


def reach_of(
    rows: UniformLog, kp: Floats, kd: Floats, robot: HeldRobot, steps: Sequence[float | None]
) -> tuple[LogRange, ...]:
    """How far the log goes at each place of the legs.

    Gains have the shape (joints,); `steps` is what `encoder_steps` found.
    """
    asked = np.abs(kp * (rows.q_des - rows.q) + kd * (rows.dq_des - rows.speed) + rows.tau_ff)
    speed, torque = (np.nanquantile(values, MOST, axis=0) for values in (np.abs(rows.speed), asked))
    ends = np.stack([np.nanquantile(rows.q, share, axis=0) for share in (MOST, 1.0 - MOST)])
    to_limit = np.stack([robot.upper - ends[0], ends[1] - robot.lower])
    reach = []
    for joints in robot.branches.T:
        side, leg = np.unravel_index(np.argmin(to_limit[:, joints]), (2, len(joints)))
        nearest = side, joints[leg]
        reach.append(
            LogRange(
                speed=float(speed[joints].max()),
                slowest=float(speed[joints].min()),
                torque=float(torque[joints].max()),
                middle=float(np.mean(rows.q[:, joints])),
                side=1.0 if side == 0 else -1.0,
                end=float(ends[nearest]),
                to_limit=float(to_limit[nearest]),
                steps=_distinct([step for j in joints if (step := steps[j]) is not None]),
            )
        )
    return tuple(reach)


def _distinct(steps: Sequence[float]) -> tuple[float, ...]:
    """Medians of steps that differ by less than `SAME_STEP`."""
    ordered = np.sort(np.asarray(steps, dtype=np.float64))
    if not len(ordered):
        return ()
    parts = np.split(ordered, np.flatnonzero(np.diff(ordered) > SAME_STEP * ordered[1:]) + 1)
    return tuple(float(np.median(part)) for part in parts)[:MOST_STEPS]


def encoder_steps(rows: UniformLog) -> tuple[float | None, ...]:
    """Step [rad] of which the angles of each joint are near multiples; None where there is none."""
    return tuple(
        # a joint at rest is near a multiple of almost anything
        _step(angles[np.abs(speed) > LEAST_MOVING])
        for angles, speed in zip(rows.q.T, rows.speed.T, strict=True)
    )


def _step(angles: Floats) -> float | None:
    if len(angles) < LEAST_ROWS:
        return None
    bins = np.floor((angles - angles.min()) / BIN).astype(np.int64)
    counts = np.bincount(bins)
    # multiples are counted from 0: far from it, lines must lie close for the phase to be right
    # between them
    size = LINES * max(len(counts), int(np.abs(angles).max() / BIN))
    # that angle is a multiple of the step, and a line of this spectrum then lies at one over the
    # step
    first, last = (int(size * BIN / step) + 1 for step in (COARSEST_STEP, FINEST_STEP))
    frequency = np.arange(first, last) / (size * BIN)
    if len(frequency) < 2:  # whatever its velocities say, the joint has not moved by a step
        return None
    # these lines alone: that of all takes long where a large prime number divides their number
    spectrum = zoom_fft(counts, np.array([first, last]) / size, m=last - first, fs=1.0) / len(
        angles
    )
    # angles that are multiples of a step are in phase at one over it
    score = np.real(spectrum * np.exp(-2j * np.pi * frequency * (angles.min() + 0.5 * BIN)))
    spread = float(np.median(np.abs(score))) / 0.6745
    best = int(np.argmax(score))
    if score[best] < max(LEAST_SPREADS * spread, LEAST_SCORE):
        return None
    # the spectrum's lines are wide; near the best one, from the angles themselves
    line = frequency[1] - frequency[0]
    near = np.linspace(frequency[best] - line, frequency[best] + line, REFINED)
    some = angles[:: max(1, len(angles) // LEAST_ROWS)]
    step = float(1.0 / near[np.argmax(np.cos(2.0 * np.pi * near[:, None] * some).sum(axis=1))])
    parts = [
        float(np.cos(2.0 * np.pi * part / step).mean()) for part in np.array_split(angles, PARTS)
    ]
    return step if sum(part > 0.5 * LEAST_SCORE for part in parts) >= TELLING else None


class NoiseScaledSignal:
    """A signal of a joint log in units of its noise, which says how small an effect it could show.

    Args:
        rows: Of the log.
        steps: Of each joint's encoder as its angles suggest [rad], None where they suggest none.
        within: Rows of each sample, shape (samples, rows each).
        branches: Joints of each leg, shape (branches, joints).
    """

    def __init__(
        self, rows: UniformLog, steps: Sequence[float | None], within: Indices, branches: Indices
    ) -> None:
        step = np.array([np.inf if s is None else s for s in steps])
        moves = (np.abs(rows.speed) > LEAST_MOVING) & np.isfinite(step) & rows.q_is_known
        # of variance 1 where phases are uniform
        phase = np.where(moves, np.sqrt(2.0) * np.cos(2.0 * np.pi * rows.q / step), 0.0)
        # (samples, branches, joints)
        self._weight = np.sqrt(moves[within].sum(axis=1))[:, branches]
        sums = phase[within].sum(axis=1)[:, branches]
        self._measured = np.divide(
            sums, self._weight, where=self._weight > 0.0, out=np.zeros_like(sums)
        )
        self._coarse = (phase.sum(axis=0) / np.maximum(moves.sum(axis=0), 1))[branches]
        self.exists = bool(np.any(self._weight))

    def residuals(self, quantisation: tuple[Floats, Floats] | None, count: int) -> Floats:
        """Measured minus expected, shape (samples, branches, joints, sets).

        Args:
            quantisation: Weight and step of each set, as in `Drives`.
            count: Number of sets.
        """
        weight = np.zeros((*self._coarse.shape, count)) if quantisation is None else quantisation[0]
        return np.asarray(
            self._measured[..., None] - self._weight[..., None] * self._coarse[..., None] * weight
        )
