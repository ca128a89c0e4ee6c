"""Run logs: one recorded run as a directory of plain tables that any lab can write and read.

    meta.json, joints.csv, imu.csv, base.csv, feet.csv, depth.npz

SI units; `t` in seconds on one monotonic clock; world z up; quaternions (w, x, y, z), body to world. Everything but
`meta.json` and `joints.csv` may be missing; a table may be Parquet with the same columns, e.g. `joints.parquet`.
Reading checks the form only: columns and types. Whether the contents make sense is for
`saltus.real2sim.screening.screen` to say.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from saltus import go1
from saltus.arrays import Floats, Indices
from saltus.errors import RecordingError

SCHEMA = "saltus-run/1"
AXES = ("x", "y", "z")
QUATERNION = ("qw", "qx", "qy", "qz")
IMU_COLUMNS = (*QUATERNION, *(f"gyro_{a}" for a in AXES), *(f"acc_{a}" for a in AXES))
BASE_COLUMNS = (*AXES, *QUATERNION, *(f"v{a}" for a in AXES))
FEET_COLUMNS = tuple(f"f_{leg}" for leg in go1.LEGS)
JOINT_SIGNALS = ("q", "dq", "q_des", "dq_des", "tau_ff", "tau_est")
REQUIRED_SIGNALS = ("q", "q_des")
SEGMENT_KEYS = ("name", "t0", "t1", "condition")


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Rows of one table."""

    time_s: Floats
    """Shape (n,)."""
    values: Floats
    """Shape (n, columns), in the order of the file's columns without `t`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointTable:
    """State measured at a time and the command that takes force then; shapes (n, joints)."""

    time_s: Floats
    q: Floats
    q_des: Floats
    dq: Floats | None = None
    dq_des: Floats | None = None
    tau_ff: Floats | None = None
    tau_est: Floats | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthTable:
    """Images of one camera."""

    arrival_s: Floats
    capture_s: Floats | None
    frame_id: Indices
    depth_mm: NDArray[np.uint16]
    """Shape (n, height, width); 0 is invalid."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RunLog:
    """A run log as it lies on disk."""

    meta: dict[str, Any]
    """Contents of meta.json: what is claimed of the rig."""
    joints: JointTable
    imu: Table | None = None
    base: Table | None = None
    feet: Table | None = None
    depth: DepthTable | None = None


def write_run_log(log: RunLog, directory: Path) -> None:
    """Writes a run log, tables as CSV with every bit of their numbers.

    Raises:
        RecordingError: the directory cannot be written.
    """
    signals = [name for name in JOINT_SIGNALS if getattr(log.joints, name) is not None]
    columns = [f"{name}_{joint}" for name in signals for joint in log.meta["joints"]]
    values = np.concatenate([getattr(log.joints, name) for name in signals], axis=1)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        (directory / "meta.json").write_text(json.dumps(log.meta, indent=2))
        _write(directory / "joints.csv", columns, Table(time_s=log.joints.time_s, values=values))
        for name, names, table in (
            ("imu", IMU_COLUMNS, log.imu),
            ("base", BASE_COLUMNS, log.base),
            ("feet", FEET_COLUMNS, log.feet),
        ):
            if table is not None:
                _write(directory / f"{name}.csv", names, table)
        if log.depth is not None:
            _write_depth(directory / "depth.npz", log.depth)
    except OSError as error:
        raise RecordingError(f"cannot write {directory}: {error.strerror}") from error


def read_run_log(directory: Path) -> RunLog:
    """Reads a run log.

    Raises:
        RecordingError: no run log, another schema, or a table that does not have the columns it must have.
    """
    try:
        meta = json.loads((directory / "meta.json").read_text())
    except (OSError, ValueError) as error:
        raise RecordingError(f"{directory} is not a run log: meta.json: {error}") from error
    if not isinstance(meta, dict):
        raise RecordingError(f"{directory} is not a run log: meta.json holds no object")
    if meta.get("schema") != SCHEMA:
        raise RecordingError(f"{directory}: schema {meta.get('schema')!r}, this version reads '{SCHEMA}'")
    joints = meta.get("joints")
    if not isinstance(joints, list) or not joints:
        raise RecordingError(f"{directory}: meta.json names no joints")
    missing = [key for key in ("kp", "kd", "control_dt") if key not in meta]
    if missing:
        raise RecordingError(f"{directory}: meta.json lacks '{missing[0]}'")
    segments(meta)
    return RunLog(
        meta=meta,
        joints=_read_joints(directory, joints),
        imu=_read_optional(directory, "imu", IMU_COLUMNS),
        base=_read_optional(directory, "base", BASE_COLUMNS),
        feet=_read_optional(directory, "feet", FEET_COLUMNS),
        depth=_read_depth(directory / "depth.npz"),
    )


def segments(meta: dict[str, Any]) -> list[dict[str, Any]]:
    """Segments that a log's meta.json names, beside `excitation` or within it; none if it names none.

    Raises:
        RecordingError: a segment without name, t0, t1 or condition, or that ends before it begins.
    """
    excitation = meta.get("excitation")
    named = meta.get("segments", excitation.get("segments") if isinstance(excitation, dict) else None) or []
    if not isinstance(named, list):
        raise RecordingError("meta.json: 'segments' must be a list")
    for segment in named:
        missing = [key for key in SEGMENT_KEYS if not isinstance(segment, dict) or key not in segment]
        if missing:
            raise RecordingError(f"meta.json: a segment lacks '{missing[0]}': {segment!r}")
        if not all(isinstance(segment[key], int | float) for key in ("t0", "t1")) or segment["t1"] <= segment["t0"]:
            raise RecordingError(f"meta.json: segment {segment['name']!r} must have numbers t0 < t1")
    return named


def _write(path: Path, columns: Sequence[str], table: Table) -> None:
    rows = np.column_stack([table.time_s, table.values])
    names = ["t", *columns]
    with path.open("wb") as file:
        file.write((",".join(names) + "\n").encode())
        options = pyarrow.csv.WriteOptions(include_header=False)
        pyarrow.csv.write_csv(pa.table(list(rows.T), names=names), file, options)


def _write_depth(path: Path, depth: DepthTable) -> None:
    arrays: dict[str, Any] = {"t_arrival": depth.arrival_s, "frame_id": depth.frame_id, "depth": depth.depth_mm}
    if depth.capture_s is not None:
        arrays["t_capture"] = depth.capture_s
    np.savez_compressed(path, **arrays)


def _read_table(directory: Path, name: str) -> tuple[Path, list[str], Floats] | None:
    """File, names of its columns and rows of a table, whichever of the two forms is there."""
    parquet, csv = directory / f"{name}.parquet", directory / f"{name}.csv"
    path = parquet if parquet.exists() else csv
    if not path.exists():
        return None
    try:
        table = pyarrow.parquet.read_table(path) if path is parquet else _read_csv(path)
        columns = [column.cast(pa.float64()).to_numpy() for column in table.columns]
    except (OSError, ValueError, pa.ArrowException) as error:
        raise RecordingError(f"cannot read {path}: {str(error).splitlines()[0]}") from error
    header = [column.strip() for column in table.column_names]
    if "t" not in header:
        raise RecordingError(f"{path}: column 't' is missing")
    if not table.num_rows:
        raise RecordingError(f"{path} has no rows")
    return path, header, np.column_stack(columns)


def _read_csv(path: Path) -> pa.Table:
    with path.open() as file:
        header = file.readline().rstrip("\r\n").split(",")
    types = {name.strip('"'): pa.float64() for name in header}
    return pyarrow.csv.read_csv(path, convert_options=pyarrow.csv.ConvertOptions(column_types=types))


def _read_optional(directory: Path, name: str, columns: Sequence[str]) -> Table | None:
    read = _read_table(directory, name)
    if read is None:
        return None
    path, header, rows = read
    missing = [column for column in columns if column not in header]
    if missing:
        raise RecordingError(f"{path}: column '{missing[0]}' is missing")
    order = [header.index(column) for column in columns]
    return Table(time_s=rows[:, header.index("t")], values=rows[:, order])


def _read_joints(directory: Path, joints: list[str]) -> JointTable:
    read = _read_table(directory, "joints")
    if read is None:
        raise RecordingError(f"{directory}: joints.csv is missing")
    path, header, rows = read
    signals: dict[str, Floats | None] = {}
    for signal in JOINT_SIGNALS:
        columns = [f"{signal}_{joint}" for joint in joints]
        missing = [name for name in columns if name not in header]
        if not missing:
            signals[signal] = rows[:, [header.index(name) for name in columns]]
        elif signal in REQUIRED_SIGNALS or len(missing) < len(columns):
            raise RecordingError(f"{path}: column '{missing[0]}' is missing")
        else:
            signals[signal] = None
    return JointTable(time_s=rows[:, header.index("t")], **signals)  # type: ignore[arg-type]


def _read_depth(path: Path) -> DepthTable | None:
    if not path.exists():
        return None
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            depth = DepthTable(
                arrival_s=arrays["t_arrival"],
                capture_s=arrays.get("t_capture"),
                frame_id=arrays["frame_id"],
                depth_mm=arrays["depth"],
            )
    except Exception as error:  # a damaged archive fails in many ways
        raise RecordingError(f"cannot read {path}: {error}") from error
    frames = len(depth.arrival_s)
    if depth.depth_mm.ndim != 3 or len(depth.depth_mm) != frames or len(depth.frame_id) != frames:
        raise RecordingError(f"{path}: {frames} arrivals, but depth {depth.depth_mm.shape}, ids {depth.frame_id.shape}")
    return depth
