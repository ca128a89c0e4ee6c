"""Compares the mean torque of each joint with the weight that it holds, which tells left from right.

Over a motion that returns to its start, accelerations and friction average out, and the drive holds the weight of the
limb. If the torque is opposite to the weight, the joint's columns have the wrong sign or belong to another leg.
"""

from collections.abc import Iterator

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.log import gains_in_force, model_of, untold
from saltus.real2sim.screening.fault import Fault
from saltus.recordings.run_log import RunLog
from saltus.sim.held import HeldRobot

STATES = 200  # states at which weights are computed, spread over the log
MIN_WEIGHT = 0.5  # Nm: the hip of a robot of 12 kg holds 0.7
AGREES = 0.5  # share of the weight by which the torque may differ from its opposite
OFF_COMMAND = 5.0  # Nm on average: friction, stops and cables hold less
MOVES = 0.2  # rad: friction can hold a joint near its command, but not for a whole motion
GAIN_RANGE = (0.6, 1.7)  # ratio of torque to weight; drives that are off by 20 % and friction stay within 0.75-1.35


def gravity_faults(log: RunLog) -> Iterator[Fault]:
    """Faults of joints of a held robot that hold the opposite of their weight, too much or too little."""
    if log.meta.get("base") != "fixed" or log.base is not None or untold(log):
        return
    names = list(log.meta["joints"])
    held = _mean_torque(log)
    rows = np.unique(np.linspace(0, len(log.joints.q) - 1, STATES).astype(int))
    weight = HeldRobot(model_of(log.meta), names).weight(log.joints.q[rows]).mean(axis=0)
    heavy = np.abs(weight) > MIN_WEIGHT
    opposite = heavy & (np.abs(held + weight) < AGREES * np.abs(weight))
    for joint in np.flatnonzero(opposite):
        text = f"{names[joint]} is held by {held[joint]:+.2f} Nm, its weight needs {weight[joint]:+.2f}: "
        yield Fault(name="against_gravity", text=text + "a flipped sign, or the columns of the leg on the other side")
    off = np.abs(held - weight) > OFF_COMMAND
    for joint in np.flatnonzero(off & ~opposite):
        text = f"{names[joint]} stands off its command as if held by {held[joint]:+.1f} Nm, its weight needs "
        text += f"{weight[joint]:+.1f}: a gear ratio, a zero or a name is wrong"
        yield Fault(name="off_command", text=text)
    moving = heavy & ~opposite & (np.ptp(log.joints.q, axis=0) > MOVES)
    if off.any() or log.joints.tau_est is not None or moving.sum() < 2:
        return
    ratio = float(np.median(held[moving] / weight[moving]))
    if not GAIN_RANGE[0] < ratio < GAIN_RANGE[1]:
        text = (
            f"by the claimed kp, joints are held with {ratio:.2f} times their weight: kp is not what meta.json claims"
        )
        yield Fault(name="wrong_gains", text=text)


def _mean_torque(log: RunLog) -> Floats:
    """Mean torque of the drives by the claimed gains [Nm], shape (joints,)."""
    kp, _ = gains_in_force(log)
    torque: Floats = np.mean(kp * (log.joints.commanded_q - log.joints.q), axis=0)
    return torque if log.joints.tau_ff is None else np.asarray(torque + np.mean(log.joints.tau_ff, axis=0))
