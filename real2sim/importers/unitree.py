"""Reads recordings of a Unitree's low level, of `saltus robot log` or of rosbag2, as a run log."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.controller.robot.unitree.drives import MS
from saltus.controller.robot.unitree.messages import (
    LOW_COMMAND,
    LOW_STATE,
    MOTORS,
    OFF,
    MessageLayout,
    UnitreeMessage,
    is_intact,
)
from saltus.errors import MessageError, RecordingError
from saltus.recordings.bag_files import open_bag
from saltus.recordings.run_claims import RigClaims
from saltus.recordings.run_log import JointTable, LogTable, RunLog, beside_its_command, period_of
from saltus.robots.robot import JOINTS

STATES_NEEDED = 2
DIGITS = 6  # behind the point
NEVER_NS = np.iinfo(np.int64).max


def is_unitree(path: Path) -> bool:
    """True for a bag that holds states of a Unitree's low level."""
    with open_bag(path) as reader:
        return any(c.msgtype == LOW_STATE.type_name for c in reader.connections)


def read_unitree(path: Path, left_out: Sequence[str] = ()) -> tuple[RunLog, list[str]]:
    """Reads states and commands.

    Times are those of the robot's own clock. A command is in force from the last state on that was
    recorded before it: a delay of the robot is then never less than nothing. The torque that a
    state tells is that of the command before, and stands beside that one.

    Args:
        path: File or folder of a bag.
        left_out: Signals and parts that the log is not to have.

    Returns:
        The log, joints in the order and counted the way of the motors, and notes.

    Raises:
        RecordingError: no bag, no states, or a robot that began anew in the midst of it.
    """
    notes: list[str] = []
    states, arrived_ns = _in_order(*_read(path, LOW_STATE, notes), path, notes)
    commands, sent_ns = _read(path, LOW_COMMAND, notes)
    tick = states["tick"].astype(np.int64)
    time_s, signals, claims = (
        MS * (tick - tick[0]),
        _measured(states),
        RigClaims(joints=list(JOINTS)),
    )
    kept = np.ones(len(states), np.bool_)
    if len(commands) > 1:
        told = np.searchsorted(sent_ns, np.append(arrived_ns[1:], NEVER_NS)) - 1
        signals |= _commanded(commands[np.maximum(told, 0)])
        signals["tau_est"] = beside_its_command(signals["tau_est"])
        kept = _within(signals, told >= 0, notes)
        claims |= _gains(signals, kept)
        by_robot_s = MS * np.interp(sent_ns, arrived_ns, tick)
        claims["control_dt"] = period_of(by_robot_s)
    else:
        notes.append("no commands (/lowcmd) were recorded")
        claims["control_dt"] = period_of(time_s)
    joints = {name: values[kept] for name, values in signals.items() if name not in left_out}
    feet = LogTable(time_s=time_s[kept], values=states["foot_force"][kept].astype(np.float64))
    log = RunLog(
        meta=claims,
        joints=JointTable(time_s=time_s[kept], **joints),
        imu=None if "imu" in left_out else _imu(states[kept], time_s[kept]),
        feet=feet,
    )
    return log, notes


def _in_order(
    states: UnitreeMessage, arrived_ns: NDArray[np.int64], path: Path, notes: list[str]
) -> tuple[UnitreeMessage, NDArray[np.int64]]:
    """States that are newer than those before them."""
    passed_ms = np.diff(states["tick"].astype(np.int64))
    if (passed_ms < 0).any():
        raise RecordingError(
            f"{path}: the robot's clock runs backwards: it began anew, or two robots were recorded"
        )
    new = np.append(True, passed_ms > 0)[: len(states)]
    if not new.all():
        notes.append(f"{int((~new).sum())} states came twice, and are left out")
    if new.sum() < STATES_NEEDED:
        raise RecordingError(f"{path} holds {new.sum()} states: it is too short")
    return states[new], arrived_ns[new]


def _within(
    signals: dict[str, Floats], told: NDArray[np.bool_], notes: list[str]
) -> NDArray[np.bool_]:
    """Rows that were commanded.

    Where only begin and end have other gains, as of a robot that is damped, these are left out.
    """
    gains = np.hstack([signals["kp"], signals["kd"]])
    usual = told & (gains == np.median(gains[told], axis=0)).all(axis=1)
    rows = np.flatnonzero(usual)
    if len(rows) < STATES_NEEDED or not usual[rows[0] : rows[-1] + 1].all():
        return told
    ends = int(told.sum() - usual.sum())
    if ends:
        notes.append(f"{ends} states at begin and end have other gains, and are left out")
    return usual


def _gains(signals: dict[str, Floats], kept: NDArray[np.bool_]) -> RigClaims:
    """Takes gains that never change out of the signals; claims are the usual ones of each joint."""
    kp, kd = (
        [float(gain) for gain in np.median(signals[name][kept], axis=0)] for name in ("kp", "kd")
    )
    if (signals["kp"][kept] == kp).all() and (signals["kd"][kept] == kd).all():
        del signals["kp"], signals["kd"]
    return {"kp": kp, "kd": kd}


def _read(
    path: Path, layout: MessageLayout, notes: list[str]
) -> tuple[UnitreeMessage, NDArray[np.int64]]:
    """Intact messages of one type, shape (n,), and when they were recorded [ns]."""
    kept: list[UnitreeMessage] = []
    times: list[int] = []
    damaged = 0
    with open_bag(path) as reader:
        chosen = [c for c in reader.connections if c.msgtype == layout.type_name]
        for _, recorded_ns, payload in reader.messages(chosen) if chosen else ():
            try:
                message = layout.read([bytes(payload)])[0]
            except MessageError as error:
                raise RecordingError(f"{path}: {error}: of another robot than a Go2") from error
            if is_intact(message):
                kept.append(message)
                times.append(recorded_ns)
            else:
                damaged += 1
    if damaged:
        notes.append(
            f"{damaged} messages {layout.type_name} have a wrong checksum, and are left out"
        )
    messages = np.stack(kept) if kept else np.zeros(0, layout.dtype)
    return messages, np.array(times, np.int64)


def _measured(states: UnitreeMessage) -> dict[str, Floats]:
    motors = states["motor_state"][:, :MOTORS]
    fields = {"q": "q", "dq": "dq", "tau_est": "tau_est"}
    return {name: motors[field].astype(np.float64) for name, field in fields.items()}


def _commanded(commands: UnitreeMessage) -> dict[str, Floats]:
    """Commands, row by row; motors that are off have neither gains nor torque."""
    motors = commands["motor_cmd"][:, :MOTORS]
    on = motors["mode"] != OFF
    fields: dict[str, tuple[str, Any]] = {
        "q_des": ("q", True), "dq_des": ("dq", True), "tau_ff": ("tau", on), "kp": ("kp", on),
        "kd": ("kd", on),
    }  # fmt: skip
    return {
        # The digits that a float32 has: 0.8 and not 0.800000012
        name: np.where(counts, motors[field], 0.0).astype(np.float64).round(DIGITS)
        for name, (field, counts) in fields.items()
    }


def _imu(states: UnitreeMessage, time_s: Floats) -> LogTable:
    imu = states["imu_state"]
    columns = [imu[name] for name in ("quaternion", "gyroscope", "accelerometer")]
    return LogTable(time_s=time_s, values=np.hstack(columns).astype(np.float64))
