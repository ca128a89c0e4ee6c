"""What a log of joints cannot show, and what it shows at a glance."""

import numpy as np

from real2sim.joint_motion import Rows
from real2sim.problem import Floats
from saltus.run_log import RunLog

LEAST_TORQUE = 5.0  # Nm commanded: drives of this class lose nothing below it (original's dynamometer table)
SLOWEST_LIMIT = 20.0  # rad/s: smallest no-load speed of robots of this class (unitree_ros)
LEAST_SPEED = 0.05  # rad/s: below it a joint stands still
LEAST_SAG_S = 5.0  # a battery does not empty in less
FINEST_STEP, COARSEST_STEP = 5e-4, 0.04
"""Steps of an encoder that are looked for [rad]: finer ones drown in noise of 1 mrad, coarser ones no drive has."""
BIN = 5e-5
"""Of the histogram of angles [rad]: a tenth of the finest step."""
TELLING = 6.0
"""Spreads of a spectrum by which a step must stand out: of 20000 values noise reaches 4.3."""
MOST_STEPS = 3


def untestable(log: RunLog, rows: Rows, kp: Floats, kd: Floats, limit: Floats) -> dict[str, str]:
    """Effects that this log cannot show, and why."""
    dq = rows.dq if rows.dq is not None else np.gradient(rows.q, rows.dt_s, axis=0)
    asked = np.abs(kp * (rows.q_des - rows.q) + kd * (rows.dq_des - dq) + rows.tau_ff)
    why: dict[str, str] = {}
    if log.joints.tau_ff is None:
        why["feedforward_delay"] = "the log has no tau_ff"
    elif np.max(np.ptp(rows.tau_ff, axis=0)) < 1e-6:
        why["feedforward_delay"] = "tau_ff never changes"
    torque = float(np.nanmax(asked))
    if torque < LEAST_TORQUE:
        why["torque_saturation"] = f"max |tau| commanded {torque:.1f} < {LEAST_TORQUE:g} Nm"
    speed = float(np.nanquantile(np.abs(dq), 0.9999))
    smallest = float(np.min(limit))
    if float(np.nanmax(asked / smallest + np.abs(dq) / SLOWEST_LIMIT)) < 1.0:
        why["torque_speed_limit"] = f"max |dq| {speed:.1f} < {SLOWEST_LIMIT:g} rad/s"
    if speed < LEAST_SPEED:
        for effect in ("viscous_friction", "coulomb_friction", "stiction", "armature", "velocity_filter"):
            why[effect] = f"max |dq| {speed:.3f} < {LEAST_SPEED:g} rad/s: nothing moves"
    if rows.time_s[-1] - rows.time_s[0] < LEAST_SAG_S:
        why["battery_sag"] = f"the log lasts {rows.time_s[-1] - rows.time_s[0]:.1f} < {LEAST_SAG_S:g} s"
    return why


def encoder_steps(rows: Rows) -> tuple[float, ...]:
    """Steps [rad] of which the angles of some joint are near multiples; empty where there are none."""
    found: list[tuple[float, float]] = []
    for angles in rows.q.T:
        bins = np.floor((angles - angles.min()) / BIN).astype(np.int64)
        size = 4 * len(np.bincount(bins))
        spectrum = np.fft.rfft(np.bincount(bins), n=size) / len(angles)
        frequency = np.fft.rfftfreq(size, BIN)
        # angles that are multiples of a step are in phase at one over it
        score = np.real(spectrum * np.exp(-2j * np.pi * frequency * (angles.min() + 0.5 * BIN)))
        tried = (frequency > 1.0 / COARSEST_STEP) & (frequency < 1.0 / FINEST_STEP)
        spread = float(np.median(np.abs(score[tried]))) / 0.6745
        best = int(np.argmax(np.where(tried, score, -np.inf)))
        if score[best] > TELLING * spread:
            found.append((float(score[best]), float(1.0 / frequency[best])))
    return tuple(step for _, step in sorted(found, reverse=True)[:MOST_STEPS])
