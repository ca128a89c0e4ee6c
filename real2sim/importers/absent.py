"""Signals that a recording has in form but not in fact: no numbers, or nothing but zeros."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.errors import RecordingError
from saltus.recordings.run_log import BASE_COLUMNS, IMU_COLUMNS, JOINT_SIGNALS, QUATERNION, RunLog, Table

MOVES_RAD = 0.01  # ten times what an encoder is off: joints that move so far have speed and torque
ZERO = ("dq", "tau_est")
"""Measured signals that nobody fills in where they are zero throughout while joints move."""
TABLES = {"imu": IMU_COLUMNS, "base": BASE_COLUMNS}


def without_absent(log: RunLog, recording: Path) -> tuple[RunLog, list[str]]:
    """The log without signals that are in truth absent, and notes on which and why.

    A signal is absent if it is no number throughout, of any joint; velocities and torques also if
    they are zero throughout while joints move; a table if a column of it is no number throughout,
    or its quaternions are zero. Rows of a table with a zero quaternion are left out: so an
    estimator tells that it has not begun yet.

    Raises:
        RecordingError: the angles of a joint are no numbers throughout.
    """
    joints, names = log.joints, log.meta["joints"]
    empty = np.all(np.isnan(joints.q), axis=0)
    if empty.any():
        name = names[int(np.argmax(empty))]
        raise RecordingError(
            f"{recording}: the angles of '{name}' are no numbers throughout; leave the joint out: in [joint_names] its "
            'name in the recording = ""'
        )
    notes: list[str] = []
    moves = float(np.nanmax(np.nanmax(joints.q, axis=0) - np.nanmin(joints.q, axis=0), initial=0.0)) > MOVES_RAD
    for signal in JOINT_SIGNALS:
        why = _why(getattr(joints, signal), names, may_be_zero=signal not in ZERO or not moves)
        if why:
            nothing: dict[str, Any] = {signal: None}
            joints = replace(joints, **nothing)
            notes.append(f"{signal} {why}, and is taken to be absent")
    tables: dict[str, Any] = {}
    for name, columns in TABLES.items():
        table = getattr(log, name)
        if table is not None:
            tables[name] = _told(name, table, columns, notes.append)
    return replace(log, joints=joints, **tables), notes


def _why(values: Floats | None, names: list[str], *, may_be_zero: bool) -> str:
    if values is None:
        return ""
    empty: NDArray[np.bool_] = np.all(np.isnan(values), axis=0)
    if empty.all():
        return "is no number throughout"
    if empty.any():
        return f"of {names[int(np.argmax(empty))]} is no number throughout"
    return "" if may_be_zero or np.any(values) else "is zero throughout while joints move"


def _told(name: str, table: Table, columns: tuple[str, ...], note: Callable[[str], None]) -> Table | None:
    """The rows of a table that tell something; None where none does."""
    empty = np.all(np.isnan(table.values), axis=0)
    if empty.any():
        note(f"{name}: {columns[int(np.argmax(empty))]} is no number throughout: the table is taken to be absent")
        return None
    turned = table.values[:, [columns.index(part) for part in QUATERNION]]
    zero = ~np.any(turned, axis=1)
    if zero.all():
        note(f"{name}: its quaternions are zero throughout: the table is taken to be absent")
        return None
    if zero.any():
        note(f"{name}: {int(zero.sum())} of {len(zero)} rows have a quaternion of zeros, and are left out")
    return Table(time_s=table.time_s[~zero], values=table.values[~zero])
