"""Makes run logs of recordings of others: bags of ROS and tables of joints."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.errors import RecordingError, nearest_hint
from saltus.real2sim.importers.file_kinds import kind_of
from saltus.real2sim.importers.table import READERS, read_log_table
from saltus.real2sim.importers.unitree import is_unitree, read_unitree
from saltus.real2sim.screening.clock_faults import MIN_ROWS, clock_faults
from saltus.real2sim.screening.screen import believed_units
from saltus.recordings.log_units import in_si, stated_units
from saltus.recordings.recording_description import RecordingDescription
from saltus.recordings.rosbag import read_rosbag
from saltus.recordings.run_claims import GAINS, SCHEMA, RigClaims, check_claims, claim_of
from saltus.recordings.run_log import (
    BASE_COLUMNS,
    IMU_COLUMNS,
    JOINT_SIGNALS,
    QUATERNION,
    REQUIRED_SIGNALS,
    LogTable,
    RunLog,
    write_run_log,
)
from saltus.robots.robot import JOINTS, Robot

WORTH_SAYING = ("q_des", "kp", "kd", "dq", "tau_est", "imu", "base", "depth")
"""Parts of a log whose absence makes effects untestable."""
OPTIONAL = (
    *(signal for signal in JOINT_SIGNALS if signal not in REQUIRED_SIGNALS),
    "imu",
    "base",
    "depth",
)
"""Signals and parts that a log may lack."""
CURES = {
    "not_a_number": "; or leave the signal out of the log: leave_out, in the description",
    "too_large": "; or leave the signal out of the log: leave_out, in the description",
    "repeated_rows": "; if its times are rounded, give rate_hz in place of time",
}
"""The cure of each fault that one signal alone has."""


@dataclass(frozen=True, kw_only=True)
class ImportResult:
    """Result of importing a recording."""

    logs: tuple[Path, ...]
    notes: tuple[str, ...]
    """Notes on what was read, and on what is not in the logs."""


def import_recording(
    recording: Path, out: Path, description: RecordingDescription, robot: Robot
) -> ImportResult:
    """Writes a bag or a table as a run log, or as several into folders below `out`:
    for each leg, or of an archive.

    Args:
        recording: Folder or file of a rosbag2, a ROS 1 bag, or a table: text, Parquet or npz.
        out: Folder of the log.
        description: What the recording does not say of itself.
        robot: The robot that was recorded. Joints are put in its order, and counted its way.

    Raises:
        RecordingError: it cannot be read; joints that the robot does not have; times that run
            backwards, or angles that no joint reaches; claims that cannot be.
    """
    _check_left_out(description.leave_out)
    _check_units(description)
    kind = kind_of(recording)
    if kind not in READERS and is_unitree(recording):
        log, notes = read_unitree(recording, description.leave_out)
        parts = {"": log}
    elif kind not in READERS:
        unit_m = description.units.depth_unit_m
        log, notes = read_rosbag(
            recording, description.topics, description.leave_out, _image_size(description), unit_m
        )
        names = [description.joint_names.get(name, name) for name in log.meta["joints"]]
        parts = {"": replace(log, meta=log.meta | {"joints": names})}
    elif description.columns is None:
        raise RecordingError(
            f"{recording}: name its columns in the [columns] of a file, with --description"
        )
    else:
        parts, notes = read_log_table(
            recording, kind, description.columns, description.joint_names, description.leave_out
        )
    logs: dict[Path, RunLog] = {}
    for name, part in parts.items():
        if len(parts) > 1 and len(part.joints.time_s) < MIN_ROWS:
            notes.append(
                f"{name}: {len(part.joints.time_s)} rows are too few to compare with anything, and "
                "are left out"
            )
            continue
        logs[out / name], told = _completed(part, recording, description, robot)
        notes += [note for note in told if note not in notes]
    if not logs:
        raise RecordingError(f"{recording}: none of its {len(parts)} logs has {MIN_ROWS} rows")
    for folder, log in logs.items():
        write_run_log(log, folder, robot)
    return ImportResult(
        logs=tuple(logs), notes=(*notes, *_lacking(next(iter(logs.values())), description))
    )


def _image_size(description: RecordingDescription) -> tuple[int, int] | None:
    """Width and height of the images that a description claims."""
    camera = description.claims.get("camera")
    width, height = (
        (camera.get("width"), camera.get("height")) if isinstance(camera, dict) else (None, None)
    )
    return (width, height) if isinstance(width, int) and isinstance(height, int) else None


def _check_left_out(names: Iterable[str]) -> None:
    for name in names:
        if name not in OPTIONAL:
            raise RecordingError(
                f"leave_out has '{name}', which no log may lack or none has: "
                f"{nearest_hint(name, OPTIONAL)}"
            )


def _check_units(description: RecordingDescription) -> None:
    """Refuses a unit that is said twice, or where it says nothing."""
    columns, units = description.columns, description.units
    if units.time_unit is not None:
        raise RecordingError(
            "[units] time_unit: a bag's stamps have their own; say a table's as [columns] time_unit"
        )
    if columns is not None and columns.angle == "deg" and (units.angle_unit or units.speed_unit):
        raise RecordingError(
            '[columns] angle = "deg" and [units] angle_unit or speed_unit say one thing twice'
        )


def _completed(
    log: RunLog, recording: Path, description: RecordingDescription, robot: Robot
) -> tuple[RunLog, list[str]]:
    """The log with all claims, in the robot's order, and notes.

    One that contradicts itself is refused.
    """
    claims = description.claims
    joints, log = _on_robot(log, robot)
    log, notes = without_absent(replace(log, meta=log.meta | {"joints": joints}), recording)
    meta: dict[str, Any] = {
        "schema": SCHEMA,
        "robot": claim_of(robot),
        "base": "free",
        "terrain": "flat",
        "notes": f"imported from {recording.name}",
        **log.meta,
        "control_dt": round(
            log.meta["control_dt"], 9
        ),  # [s], as differences of times leave digits behind the ns
        **claims,
        "joints": joints,
    }
    if log.depth is None:
        meta.pop("camera", None)
    elif "camera" in log.meta | claims:
        angles = {"pitch": robot.camera_pitch, "roll": robot.camera_roll, "yaw": robot.camera_yaw}
        mount = {"position": robot.camera_position.tolist(), **angles}
        meta["camera"] = mount | log.meta.get("camera", {}) | claims.get("camera", {})
    try:
        check_claims(meta)
    except RecordingError as error:
        raise RecordingError(f"{recording}: {error} (say it in [claims])") from error
    stated = description.units if "units" not in claims else stated_units(meta)
    # Images are in millimetres already
    log = in_si(replace(log, meta=cast(RigClaims, meta)), replace(stated, depth_unit_m=None))
    faults = [
        f for f in (*clock_faults(log), *believed_units(log)) if f.is_fatal or f.name == "too_short"
    ]
    if faults:
        raise RecordingError(f"{recording}: {faults[0].text}{CURES.get(faults[0].name, '')}")
    return log, notes


def _on_robot(log: RunLog, robot: Robot) -> tuple[list[str], RunLog]:
    """Names of the robot's joints in their order,
    and the log with columns in that order, counted its way.
    """
    own = [name.removesuffix("_joint") for name in log.meta["joints"]]
    for name in own:
        if name and name not in JOINTS:
            hint = f"{nearest_hint(name, JOINTS)}; say in [joint_names] which it is"
            raise RecordingError(f"the robot '{robot.name}' has no joint '{name}': {hint}")
    joints = [name for name in JOINTS if name in own]
    order = [own.index(name) for name in joints]
    sign = robot.joint_sign[[JOINTS.index(name) for name in joints]]
    signals = {
        name: values for name in JOINT_SIGNALS if (values := getattr(log.joints, name)) is not None
    }
    turned = {
        name: values[:, order] * (1.0 if name in GAINS else sign)
        for name, values in signals.items()
    }
    return joints, replace(log, joints=replace(log.joints, **turned))


def _lacking(log: RunLog, description: RecordingDescription) -> list[str]:
    """Data that `find` will miss."""
    # Claims before columns of gains, tables before claims
    there = vars(log.joints) | log.meta | vars(log)
    absent = [part for part in WORTH_SAYING if there.get(part) is None]
    notes = (
        [f"not in the log: {', '.join(absent)}; what needs them will be untestable"]
        if absent
        else []
    )
    if "base" not in description.claims:
        notes.append(
            'the robot is taken to have moved freely: if it was held, say base = "fixed" in '
            "[claims]"
        )
    return [*notes, *(fault.text for fault in believed_units(log))]


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
            f"{recording}: the angles of '{name}' are no numbers throughout; leave the joint out: "
            "in [joint_names] its "
            'name in the recording = ""'
        )
    notes: list[str] = []
    moves = (
        float(np.nanmax(np.nanmax(joints.q, axis=0) - np.nanmin(joints.q, axis=0), initial=0.0))
        > MOVES_RAD
    )
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


def _told(
    name: str, table: LogTable, columns: tuple[str, ...], note: Callable[[str], None]
) -> LogTable | None:
    """The rows of a table that tell something; None where none does."""
    empty = np.all(np.isnan(table.values), axis=0)
    if empty.any():
        note(
            f"{name}: {columns[int(np.argmax(empty))]} is no number throughout: the table is taken "
            "to be absent"
        )
        return None
    turned = table.values[:, [columns.index(part) for part in QUATERNION]]
    zero = ~np.any(turned, axis=1)
    if zero.all():
        note(f"{name}: its quaternions are zero throughout: the table is taken to be absent")
        return None
    if zero.any():
        note(
            f"{name}: {int(zero.sum())} of {len(zero)} rows have a quaternion of zeros, and are "
            "left out"
        )
    return LogTable(time_s=table.time_s[~zero], values=table.values[~zero])
