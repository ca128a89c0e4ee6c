"""Run logs: one recorded run as a directory of plain tables that any lab can write and read.

    meta.json, joints.csv, imu.csv, base.csv, feet.csv, depth.npz

SI units; `t` in seconds on one monotonic clock; world z up; quaternions (w, x, y, z), body to world. Everything but
`meta.json` and `joints.csv` may be missing; a table may be Parquet with the same columns, e.g. `joints.parquet`.
Reading checks the form only: columns and types. Whether the contents make sense is for
`saltus.real2sim.screening.screen` to say.
"""

import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from saltus.archive import check_archive
from saltus.arrays import Floats, Indices
from saltus.errors import RecordingError, nearest_hint
from saltus.recordings.run_claims import check_claims, claim_of
from saltus.robots.robot import LEGS, Robot
from saltus.robots.shipped import shipped_robots

FARTHEST_MM = 65535  # what uint16 holds
AXES = ("x", "y", "z")
QUATERNION = ("qw", "qx", "qy", "qz")
IMU_COLUMNS = (*QUATERNION, *(f"gyro_{a}" for a in AXES), *(f"acc_{a}" for a in AXES))
BASE_COLUMNS = (*AXES, *QUATERNION, *(f"v{a}" for a in AXES))
FEET_COLUMNS = tuple(f"f_{leg}" for leg in LEGS)
JOINT_SIGNALS = ("q", "dq", "q_des", "dq_des", "tau_ff", "tau_est", "kp", "kd")
REQUIRED_SIGNALS = ("q",)
DEPTH_ARRAYS = {
    "t_arrival": (1, "fiu", "seconds"),
    "t_capture": (1, "fiu", "seconds"),
    "frame_id": (1, "iu", "whole numbers"),
    "depth": (3, "iu", "images of whole millimetres, (frames, rows, columns)"),
}
"""Arrays of depth.npz: number of dimensions, kinds of numbers, and what they are."""


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
    q_des: Floats | None = None
    dq: Floats | None = None
    dq_des: Floats | None = None
    tau_ff: Floats | None = None
    tau_est: Floats | None = None
    kp: Floats | None = None
    """Gains that go with the command, where they are not those of the claims throughout."""
    kd: Floats | None = None

    @property
    def commanded_q(self) -> Floats:
        """`q_des` of a log that has it.

        Raises:
            RecordingError: it has not.
        """
        if self.q_des is None:
            raise RecordingError("no commands of the joints (q_des)")
        return self.q_des


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


def write_run_log(log: RunLog, directory: Path, robot: Robot | None = None) -> None:
    """Writes a run log, tables as CSV with every bit of their numbers.

    Args:
        log: What is written.
        directory: Folder for it; it is made.
        robot: That of the log; its model is written beside the tables where Saltus does not ship it.

    Raises:
        RecordingError: the directory cannot be written, or holds a run log already.
    """
    refuse_run_log(directory)
    signals = [name for name in JOINT_SIGNALS if getattr(log.joints, name) is not None]
    columns = [f"{name}_{joint}" for name in signals for joint in log.meta["joints"]]
    values = np.concatenate([getattr(log.joints, name) for name in signals], axis=1)
    tables = {
        "joints": (columns, Table(time_s=log.joints.time_s, values=values)),
        "imu": (IMU_COLUMNS, log.imu),
        "base": (BASE_COLUMNS, log.base),
        "feet": (FEET_COLUMNS, log.feet),
    }
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for name, (names, table) in tables.items():
            if table is not None:
                _write(directory / f"{name}.csv", names, table)
        if log.depth is not None:
            _write_depth(directory / "depth.npz", log.depth)
        if robot is not None and robot.name not in shipped_robots():
            (directory / claim_of(robot)).write_text(robot.mjcf, encoding="utf-8")
        # last: without it a folder is no run log, so that one that could not be finished is not taken for one
        (directory / "meta.json").write_text(json.dumps(log.meta, indent=2), encoding="utf-8")
    except OSError as error:
        raise RecordingError(f"cannot write {directory}: {error.strerror or error}") from error


def refuse_run_log(directory: Path) -> None:
    """Keeps a run log from being written over.

    Raises:
        RecordingError: the directory holds one.
    """
    if (directory / "meta.json").exists():
        raise RecordingError(f"{directory} holds a run log already: name another folder")


def read_run_log(directory: Path) -> RunLog:
    """Reads a run log.

    Raises:
        RecordingError: no run log, a claim that cannot be, or a table that does not have the columns it must have.
    """
    meta = read_claims(directory)
    return RunLog(
        meta=meta,
        joints=_read_joints(directory, meta["joints"]),
        imu=_read_optional(directory, "imu", IMU_COLUMNS),
        base=_read_optional(directory, "base", BASE_COLUMNS),
        feet=_read_optional(directory, "feet", FEET_COLUMNS),
        depth=_read_depth(directory / "depth.npz"),
    )


def read_claims(directory: Path) -> dict[str, Any]:
    """Contents of meta.json.

    Raises:
        RecordingError: there is none (says what the directory is instead), or a claim that cannot be.
    """
    path = directory / "meta.json"
    if not directory.exists():
        raise RecordingError(f"{directory} is not a run log: there is no such folder")
    if not directory.is_dir():
        raise RecordingError(
            f"{directory} is a file; a run log is a folder with meta.json and joints.csv: "
            "`saltus real2sim import` makes one of a bag or a table"
        )
    if not path.exists():
        recordings = sorted(other.name for kind in ("mcap", "db3") for other in directory.glob(f"*.{kind}"))
        instead = f"; `saltus real2sim import` makes one of the {recordings[0]} in it" if recordings else ""
        raise RecordingError(f"{directory} is not a run log: it has no meta.json{instead}")
    try:
        meta = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise RecordingError(f"{directory}: cannot read meta.json: {error}") from error
    if not isinstance(meta, dict):
        raise RecordingError(f"{directory}: meta.json holds no object with named values")
    try:
        check_claims(meta)
    except RecordingError as error:
        raise RecordingError(f"{directory}: {error}") from error
    return meta


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


def read_columns(path: Path, wanted: Sequence[str]) -> dict[str, Floats]:
    """Columns of a CSV of any kind by their names, shape (rows,) each.

    Raises:
        RecordingError: it cannot be read, lacks a column or rows, or a column holds text.
    """
    try:
        table = _read_csv(path, list(dict.fromkeys(wanted)))
        columns = {name: table[name].to_numpy() for name in wanted}
    except (OSError, ValueError, KeyError, pa.ArrowException) as error:  # KeyError: two columns of one name
        raise RecordingError(f"cannot read {path}: {str(error).splitlines()[0]}") from error
    if not table.num_rows:
        raise RecordingError(f"{path} has no rows")
    return columns


def _read_csv(path: Path, wanted: Sequence[str] | None = None) -> pa.Table:
    with path.open(encoding="utf-8") as file:
        header = [name.strip().strip('"') for name in file.readline().split(",")]
    if missing := [name for name in wanted or () if name not in header]:
        raise ValueError(f"column '{missing[0]}' is missing: {nearest_hint(missing[0], header)}")
    convert = pyarrow.csv.ConvertOptions(
        column_types=dict.fromkeys(header, pa.float64()), include_columns=wanted or header
    )
    # With threads and memory of its own Arrow keeps 40 MB after two hundred small logs; 30,000 rows come no faster.
    read = pyarrow.csv.ReadOptions(column_names=header, skip_rows=1, use_threads=False)
    pool = pa.system_memory_pool()
    return pyarrow.csv.read_csv(path, read_options=read, convert_options=convert, memory_pool=pool)


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
    if not zipfile.is_zipfile(path):
        raise RecordingError(f"cannot read {path}: it is no archive of arrays, as numpy.savez writes it, or is cut off")
    try:
        check_archive(path)
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in DEPTH_ARRAYS if name in archive}
    except Exception as error:  # a damaged archive fails in many ways
        raise RecordingError(f"cannot read {path}: {str(error).splitlines()[0]}") from error
    missing = [name for name in DEPTH_ARRAYS if name not in arrays and name != "t_capture"]
    if missing:
        raise RecordingError(f"{path}: array '{missing[0]}' is missing")
    frames = arrays["t_arrival"].shape[:1]
    for name, (dimensions, kinds, meaning) in DEPTH_ARRAYS.items():
        array = arrays.get(name)
        if array is None:
            continue
        if (
            array.ndim != dimensions
            or array.shape[:1] != frames
            or array.dtype.kind not in kinds
            or 0 in array.shape[1:]
        ):
            found = f"{array.dtype} of shape {array.shape}"
            raise RecordingError(f"{path}: '{name}' is {found}; it must be {meaning}, one for each arrival")
    depth = arrays["depth"]
    if depth.size and not 0 <= int(depth.min()) <= int(depth.max()) <= FARTHEST_MM:
        raise RecordingError(
            f"{path}: 'depth' reaches from {depth.min()} to {depth.max()} mm; uint16 holds 0 to {FARTHEST_MM}"
        )
    return DepthTable(
        arrival_s=arrays["t_arrival"].astype(np.float64),
        capture_s=arrays["t_capture"].astype(np.float64) if "t_capture" in arrays else None,
        frame_id=arrays["frame_id"].astype(np.int64),
        depth_mm=depth.astype(np.uint16),
    )
