"""Compares the mean torque of each joint with the weight that it holds,
which tells left from right.

Over a motion that returns to its start, accelerations and friction average out, and the drive holds
the weight of the limb. If the torque is opposite to the weight, the joint's columns have the wrong
sign or belong to another leg.
"""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import uniform_filter1d

from saltus.arrays import Floats
from saltus.constants import GRAVITY
from saltus.real2sim.problem.log import (
    claimed_model,
    gains_in_force,
    joint_rates,
    why_commands_unknown,
)
from saltus.real2sim.screening.channel_scales import LogFault
from saltus.recordings.run_log import RunLog
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import JOINTS, Robot
from saltus.sim.held_robot import HeldRobot

STATES = 200  # states at which weights are computed, spread over the log
MIN_WEIGHT = 0.5  # Nm: the hip of a robot of 12 kg holds 0.7
AGREES = 0.5  # share of the weight by which the torque may differ from its opposite
OFF_COMMAND = 5.0  # Nm on average: friction, stops and cables hold less
MOVES = 0.2  # rad: friction can hold a joint near its command, but not for a whole motion
# Share of the weight that is missing: drives of 0.7 of their strength, a load of half the robot
LOADED = (
    0.4,
    2.5,
)
HOLDS = 0.5  # share of the weight that tau_ff must hold, or explain, so that it is compared
SLOW_S = 0.6  # accelerations average out
# Ratio of torque to weight; drives that are off by 20 % and friction stay within 0.75-1.35
GAIN_RANGE = (
    0.6,
    1.7,
)


def gravity_faults(log: RunLog) -> Iterator[LogFault]:
    """Faults of joints of a held robot that hold the opposite of their weight,
    too much or too little.
    """
    if log.meta.get("base") != "fixed" or log.base is not None or why_commands_unknown(log):
        return
    names = list(log.meta["joints"])
    held = _mean_torque(log)
    rows = np.unique(np.linspace(0, len(log.joints.q) - 1, STATES).astype(int))
    weight = HeldRobot(claimed_model(log), names).weight(log.joints.q[rows]).mean(axis=0)
    heavy = np.abs(weight) > MIN_WEIGHT
    opposite = heavy & (np.abs(held + weight) < AGREES * np.abs(weight))
    for joint in np.flatnonzero(opposite):
        text = (
            f"{names[joint]} is held by {held[joint]:+.2f} Nm, its weight needs "
            f"{weight[joint]:+.2f}: "
        )
        yield LogFault(
            name="against_gravity",
            text=text + "a flipped sign, or the columns of the leg on the other side",
        )
    off = np.abs(held - weight) > OFF_COMMAND
    for joint in np.flatnonzero(off & ~opposite):
        text = (
            f"{names[joint]} stands off its command as if held by {held[joint]:+.1f} Nm, "
            "its weight needs "
        )
        text += f"{weight[joint]:+.1f}: a gear ratio, a zero or a name is wrong"
        yield LogFault(name="off_command", text=text)
    moving = heavy & ~opposite & (np.ptp(log.joints.q, axis=0) > MOVES)
    if off.any() or log.joints.tau_est is not None or moving.sum() < 2:
        return
    ratio = float(np.median(held[moving] / weight[moving]))
    if not GAIN_RANGE[0] < ratio < GAIN_RANGE[1]:
        text = (
            f"by the claimed kp, joints are held with {ratio:.2f} times their weight: "
            "kp is not what meta.json claims"
        )
        yield LogFault(name="wrong_gains", text=text)


def feedforward_faults(log: RunLog) -> Iterator[LogFault]:
    """Faults of tau_ff that no tau_est is compared with:
    by the weight that it and the gains hold.
    """
    joints = log.joints
    if (
        joints.tau_ff is None
        or joints.tau_est is not None
        or why_commands_unknown(log)
        or not joints.tau_ff.any()
    ):
        return
    kp, kd = gains_in_force(log)
    told = 0.0 if joints.dq_des is None else joints.dq_des
    by_gains = kp * (joints.commanded_q - joints.q) + kd * (told - joint_rates(joints))
    held = _weight_of_joints if log.meta.get("base") == "fixed" else _weight_on_feet
    compared = held(log, by_gains, joints.tau_ff)
    if compared is None:
        return
    rest, part = compared
    power = max(float(np.sum(part**2)), float(np.finfo(np.float64).tiny))
    share = float(np.sum(rest * part)) / power
    left = float(np.sum((rest - share * part) ** 2)) / max(
        float(np.sum(rest**2)), float(np.finfo(np.float64).tiny)
    )
    if left > 1.0 - HOLDS or LOADED[0] < share < LOADED[1]:
        return
    text = (
        f"tau_ff of all joints is about {1.0 / share:.2g} times its part in holding the weight, "
        "by the gains and "
    )
    text += "the model: " + ("a sign is flipped" if share < 0.0 else "another unit?")
    yield LogFault(name="flipped_sign" if share < 0.0 else "torque_unit", text=text)


def _weight_of_joints(log: RunLog, by_gains: Floats, extra: Floats) -> tuple[Floats, Floats]:
    """Weight of a held robot's joints less what gains hold in slow motion,
    and tau_ff [Nm], (rows, joints).
    """
    width = max(1, round(SLOW_S / float(np.median(np.diff(log.joints.time_s)))))
    rows = np.unique(np.linspace(0, len(log.joints.q) - 1, STATES).astype(int))
    q, gained, part = (
        uniform_filter1d(each, width, axis=0)[rows] for each in (log.joints.q, by_gains, extra)
    )
    return HeldRobot(claimed_model(log), list(log.meta["joints"])).weight(q) - gained, part


def _weight_on_feet(log: RunLog, by_gains: Floats, extra: Floats) -> tuple[Floats, Floats] | None:
    """Weight of a standing robot less what gains hold, and what tau_ff holds [N], shape () each.

    None where the gains hold it.
    """
    robot, names = (
        claimed_model(log),
        tuple(name.removesuffix("_joint") for name in log.meta["joints"]),
    )
    if not isinstance(robot, Robot) or names != JOINTS:
        return None
    rows = np.unique(np.linspace(0, len(log.joints.q) - 1, STATES).astype(int))
    turned = np.asarray(LegKinematics(robot).jacobian(log.joints.q[rows])).swapaxes(-1, -2)
    gained, part = (
        -np.linalg.solve(turned, each[rows].reshape(-1, 4, 3, 1))[..., 2, 0].sum(axis=1).mean()
        for each in (by_gains, extra)
    )
    weight = GRAVITY * robot.mass
    return (weight - gained, part) if abs(weight - gained) > HOLDS * weight else None


def _mean_torque(log: RunLog) -> Floats:
    """Mean torque of the drives by the claimed gains [Nm], shape (joints,)."""
    kp, _ = gains_in_force(log)
    torque: Floats = np.mean(kp * (log.joints.commanded_q - log.joints.q), axis=0)
    return (
        torque
        if log.joints.tau_ff is None
        else np.asarray(torque + np.mean(log.joints.tau_ff, axis=0))
    )
