"""Run logs: one recorded run as a directory of plain tables that any lab can write and read.

    meta.json, joints.csv, imu.csv, base.csv, feet.csv, depth.npz

SI units, unless `units` in meta.json states others; `t` in seconds on one monotonic clock; world z
up; quaternions (w, x, y, z), body to world. Everything but `meta.json` and `joints.csv` may be
missing. A table may be Parquet with the same columns, e.g. `joints.parquet`, or an archive of
numpy, `joints.npz`, with an array for each column, or for each signal one of shape (rows, joints).
Reading checks the form only: columns and types. Whether the contents make sense is for
`saltus.real2sim.screening.screen` to say.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.csv
from numpy.typing import NDArray

from saltus.arrays import Floats, Indices
from saltus.errors import RecordingError
from saltus.recordings.file_columns import opened_archive, read_archive, read_parquet, read_text
from saltus.recordings.log_units import FARTHEST_MM, in_si, stated_units
from saltus.recordings.run_claims import RigClaims, check_claims, claim_of
from saltus.robots.robot import LEGS, Robot

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
PAUSE = (
    2.5  # times the usual step: neither rounding to the period nor one lost row makes steps as long
)
FORMS = {"parquet": read_parquet, "npz": read_archive, "csv": read_text}
"""How the tables are read, by the ending of their files; the first that is there is taken."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LogTable:
    """Rows of one table of a run log, such as its IMU."""

    time_s: Floats
    """Shape (n,)."""
    values: Floats
    """Shape (n, columns), in the order of the file's columns without `t`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointTable:
    """Joints of a run log: state measured at a time and the command that takes force then; shapes
    (n, joints).
    """

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
    """Depth images of one camera in a run log."""

    arrival_s: Floats
    capture_s: Floats | None
    frame_id: Indices
    depth_mm: NDArray[np.uint16]
    """Shape (n, height, width); 0 is invalid."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RunLog:
    """A run log as it lies on disk."""

    meta: RigClaims
    """Contents of meta.json: what is claimed of the rig."""
    joints: JointTable
    imu: LogTable | None = None
    base: LogTable | None = None
    feet: LogTable | None = None
    depth: DepthTable | None = None


def beside_its_command(told: Floats) -> Floats:
    """The torque that each row's command makes, of that which states tell, shape (rows, joints).

    A drive tells the torque of the command before: each is moved up by a row.
    """
    return np.concatenate([told[1:], told[-1:]])


def period_of(time_s: Floats) -> float:
    """The usual time between rows [s], also where their times are rounded more coarsely than it.

    It is the mean of the steps that are no pauses: their median would be 1 ms of rows at 800 Hz in
    whole milliseconds.
    """
    steps = np.diff(time_s)
    usual = float(np.median(steps))
    return float(np.mean(steps[steps < PAUSE * usual] if usual > 0.0 else steps))


def write_run_log(log: RunLog, directory: Path, robot: Robot | None = None) -> None:
    """Writes a run log, tables as CSV with every bit of their numbers.

    Args:
        log: What is written.
        directory: Folder for it; it is made.
        robot: That of the log; its model is written beside the tables where Saltus does not ship
            it.

    Raises:
        RecordingError: the directory cannot be written, or holds a run log already.
    """
    refuse_run_log(directory)
    signals = [name for name in JOINT_SIGNALS if getattr(log.joints, name) is not None]
    columns = [f"{name}_{joint}" for name in signals for joint in log.meta["joints"]]
    values = np.concatenate([getattr(log.joints, name) for name in signals], axis=1)
    tables = {
        "joints": (columns, LogTable(time_s=log.joints.time_s, values=values)),
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
        if robot is not None and (claim := claim_of(robot)) != robot.name:
            (directory / claim).write_text(robot.mjcf, encoding="utf-8")
        # last: without it a folder is no run log, so that one that could not be finished is not
        # taken for one
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
        RecordingError: no run log, a claim that cannot be, or a table that does not have the
            columns it must have.
    """
    meta = read_claims(directory)
    log = RunLog(
        meta=meta,
        joints=_read_joints(directory, meta["joints"]),
        imu=_read_optional(directory, "imu", IMU_COLUMNS),
        base=_read_optional(directory, "base", BASE_COLUMNS),
        feet=_read_optional(directory, "feet", FEET_COLUMNS),
        depth=_read_depth(directory / "depth.npz"),
    )
    return in_si(log, stated_units(meta))


def read_claims(directory: Path) -> RigClaims:
    """Contents of meta.json.

    Raises:
        RecordingError: there is none (says what the directory is instead), or a claim that cannot
            be.
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
        recordings = sorted(
            other.name for kind in ("mcap", "db3") for other in directory.glob(f"*.{kind}")
        )
        instead = (
            f"; `saltus real2sim import` makes one of the {recordings[0]} in it"
            if recordings
            else ""
        )
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
    return cast(RigClaims, meta)


def _write(path: Path, columns: Sequence[str], table: LogTable) -> None:
    rows = np.column_stack([table.time_s, table.values])
    names = ["t", *columns]
    with path.open("wb") as file:
        file.write((",".join(names) + "\n").encode())
        options = pyarrow.csv.WriteOptions(include_header=False)
        pyarrow.csv.write_csv(pa.table(list(rows.T), names=names), file, options)


def _write_depth(path: Path, depth: DepthTable) -> None:
    arrays: dict[str, Any] = {
        "t_arrival": depth.arrival_s,
        "frame_id": depth.frame_id,
        "depth": depth.depth_mm,
    }
    if depth.capture_s is not None:
        arrays["t_capture"] = depth.capture_s
    np.savez_compressed(path, **arrays)


def _read_table(directory: Path, name: str) -> tuple[Path, dict[str, Floats]] | None:
    """File and columns of a table, whichever of its forms is there."""
    for ending, read in FORMS.items():
        path = directory / f"{name}.{ending}"
        if path.exists():
            found = read(path)
            columns = found.values
            if found.notes:
                raise RecordingError(
                    f"{path}: {found.notes[0].replace('left out', 'must be deleted')}"
                )
            if "t" not in columns:
                raise RecordingError(f"{path}: column 't' is missing")
            if lengths := {len(values) for values in columns.values()} - {len(columns["t"])}:
                raise RecordingError(
                    f"{path}: 't' has {len(columns['t'])} rows, another column {lengths.pop()}"
                )
            return path, columns
    return None


def _read_optional(directory: Path, name: str, columns: Sequence[str]) -> LogTable | None:
    read = _read_table(directory, name)
    if read is None:
        return None
    path, there = read
    for column in columns:
        if column not in there:
            raise RecordingError(f"{path}: column '{column}' is missing")
    return LogTable(
        time_s=there["t"], values=np.column_stack([there[column] for column in columns])
    )


def _read_joints(directory: Path, joints: list[str]) -> JointTable:
    read = _read_table(directory, "joints")
    if read is None:
        raise RecordingError(f"{directory}: joints.csv is missing")
    path, there = read
    signals: dict[str, Floats | None] = {}
    for signal in JOINT_SIGNALS:
        columns = [f"{signal}_{joint}" for joint in joints]
        missing = [name for name in columns if name not in there]
        whole = there.get(signal)  # of an archive: all joints in one array
        if whole is not None and whole.shape[1:] == (len(joints),):
            signals[signal] = whole
        elif not missing:
            signals[signal] = np.column_stack([there[name] for name in columns])
        elif signal in REQUIRED_SIGNALS or len(missing) < len(columns):
            raise RecordingError(f"{path}: column '{missing[0]}' is missing")
        else:
            signals[signal] = None
    return JointTable(time_s=there["t"], **signals)  # type: ignore[arg-type]


def _read_depth(path: Path) -> DepthTable | None:
    if not path.exists():
        return None
    with opened_archive(path) as archive:
        try:
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
            raise RecordingError(
                f"{path}: '{name}' is {found}; it must be {meaning}, one for each arrival"
            )
    depth = arrays["depth"]
    if depth.size and not 0 <= int(depth.min()) <= int(depth.max()) <= FARTHEST_MM:
        raise RecordingError(
            f"{path}: 'depth' reaches from {depth.min()} to {depth.max()} mm; uint16 holds 0 to "
            f"{FARTHEST_MM}"
        )
    return DepthTable(
        arrival_s=arrays["t_arrival"].astype(np.float64),
        capture_s=arrays["t_capture"].astype(np.float64) if "t_capture" in arrays else None,
        frame_id=arrays["frame_id"].astype(np.int64),
        depth_mm=depth.astype(np.uint16),
    )
