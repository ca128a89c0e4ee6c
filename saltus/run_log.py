"""Run logs: one recorded run as a directory of plain tables that any lab can write and read.

    meta.json, joints.csv, imu.csv, base.csv, feet.csv, depth.npz

SI units; `t` in seconds on one monotonic clock; world z up; quaternions (w, x, y, z), body to world. Everything but
`meta.json` and `joints.csv` may be missing. Columns are in `README.md` of a log's schema, "saltus-run/1".
"""

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus import go1
from saltus.errors import RecordingError
from saltus.messages import DepthFrame, GroundTruth, JointLog, RobotState
from saltus.recording import Recording
from saltus.terrain.curriculum import make_terrain

Floats = NDArray[np.float64]

SCHEMA = "saltus-run/1"
NO_RETURN = 65535  # DepthFrame: nothing within range; a run log knows only "invalid", 0
AXES = ("x", "y", "z")
QUATERNION = ("qw", "qx", "qy", "qz")
IMU_COLUMNS = (*QUATERNION, *(f"gyro_{a}" for a in AXES), *(f"acc_{a}" for a in AXES))
BASE_COLUMNS = (*AXES, *QUATERNION, *(f"v{a}" for a in AXES))
FEET_COLUMNS = tuple(f"f_{leg}" for leg in go1.LEGS)
JOINT_SIGNALS = ("q", "dq", "q_des", "dq_des", "tau_ff", "tau_est")
REQUIRED_SIGNALS = ("q", "q_des")


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Rows of one CSV file."""

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
    frame_id: NDArray[np.int64]
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


def export_run_log(recording: Recording, directory: Path) -> None:
    """Writes a recording as a run log.

    Raises:
        RecordingError: the recording has no joint data, or the directory cannot be written.
    """
    write_run_log(_collect(recording), directory)


def write_run_log(log: RunLog, directory: Path) -> None:
    """Writes a run log.

    Raises:
        RecordingError: the directory cannot be written.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        (directory / "meta.json").write_text(json.dumps(log.meta, indent=2))
        signals = [name for name in JOINT_SIGNALS if getattr(log.joints, name) is not None]
        columns = [f"{name}_{joint}" for name in signals for joint in log.meta["joints"]]
        values = np.concatenate([getattr(log.joints, name) for name in signals], axis=1)
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
    if meta.get("schema") != SCHEMA:
        raise RecordingError(f"{directory}: schema {meta.get('schema')!r}, this version reads '{SCHEMA}'")
    joints = meta.get("joints")
    if not isinstance(joints, list) or not joints:
        raise RecordingError(f"{directory}: meta.json names no joints")
    return RunLog(
        meta=meta,
        joints=_read_joints(directory / "joints.csv", joints),
        imu=_read_optional(directory / "imu.csv", IMU_COLUMNS),
        base=_read_optional(directory / "base.csv", BASE_COLUMNS),
        feet=_read_optional(directory / "feet.csv", FEET_COLUMNS),
        depth=_read_depth(directory / "depth.npz"),
    )


def _collect(recording: Recording) -> RunLog:
    logs = [m for _, _, m in recording.messages("controller/joints") if isinstance(m, JointLog)]
    if not logs:
        raise RecordingError(f"{recording.path} has no joint data (controller/joints)")
    states = [m for _, _, m in recording.messages("controller/state") if isinstance(m, RobotState)]
    truths = [m for _, _, m in recording.messages("plant/truth") if isinstance(m, GroundTruth)]
    frames = [(t, m) for t, _, m in recording.messages("camera/depth") if isinstance(m, DepthFrame)]
    imu = [(*m.quaternion_base_in_world, *m.angular_velocity_base, *m.acceleration_base) for m in states]
    base = [(*m.position_base_in_world, *m.quaternion_base_in_world, *m.velocity_base_in_world) for m in truths]
    return RunLog(
        meta=_meta(recording, logs, [frame for _, frame in frames]),
        joints=_joints(logs),
        imu=_table([m.time_ns for m in states], imu),
        base=_table([m.time_ns for m in truths], base),
        feet=_table([m.time_ns for m in truths], [m.foot_force for m in truths]),
        depth=_depth(frames),
    )


def _meta(recording: Recording, logs: list[JointLog], frames: list[DepthFrame]) -> dict[str, Any]:
    last = logs[-1].time_ns * 1e-9 + logs[-1].dt_s * len(logs[-1].position)
    segment = {"name": "run", "t0": logs[0].time_ns * 1e-9, "t1": last, "condition": "run"}
    meta: dict[str, Any] = {
        "schema": SCHEMA,
        "robot": "go1",
        "base": "free",
        "joints": list(go1.JOINTS),
        "kp": np.median(np.concatenate([log.kp for log in logs]), axis=0).tolist(),
        "kd": np.median(np.concatenate([log.kd for log in logs]), axis=0).tolist(),
        "control_dt": logs[0].dt_s,
        "excitation": {"text": "a run of the whole stack; gains change with the gait", "segments": [segment]},
        "terrain": "flat",
        "notes": f"exported from {recording.path.name}",
    }
    if recording.config is not None:
        if recording.config.terrain.terrain != "flat":
            terrain = make_terrain(recording.config.terrain)
            boxes = zip(terrain.box_center.tolist(), terrain.box_size.tolist(), strict=True)
            meta["terrain"] = [{"center": center, "size": size} for center, size in boxes]
        meta["config"] = asdict(recording.config)
    if frames:
        meta["camera"] = _camera(frames[0])
    return meta


def _camera(frame: DepthFrame) -> dict[str, Any]:
    height, width = frame.depth.shape
    intrinsics = {name: float(getattr(frame, name)) for name in ("fx", "fy", "cx", "cy")}
    return {
        **intrinsics,
        "width": width,
        "height": height,
        "position": go1.CAMERA_POSITION.tolist(),
        "pitch": go1.CAMERA_PITCH,
        "rate": 50.0,
        "latency": 0.050,
    }


def _joints(logs: list[JointLog]) -> JointTable:
    def rows(name: str) -> Floats:
        return np.concatenate([np.asarray(getattr(log, name), dtype=np.float64) for log in logs])

    times = [log.time_ns * 1e-9 + log.dt_s * np.arange(len(log.position)) for log in logs]
    return JointTable(
        time_s=np.concatenate(times),
        q=rows("position"),
        dq=rows("velocity"),
        q_des=rows("position_desired"),
        dq_des=rows("velocity_desired"),
        tau_ff=rows("torque_feedforward"),
        tau_est=rows("torque_estimated"),
    )


def _table(times_ns: list[int], rows: Sequence[Any]) -> Table | None:
    if not times_ns:
        return None
    return Table(time_s=np.array(times_ns) * 1e-9, values=np.array(rows, dtype=np.float64))


def _depth(frames: list[tuple[int, DepthFrame]]) -> DepthTable | None:
    if not frames:
        return None
    millimetres = [_to_millimetres(frame) for _, frame in frames]
    return DepthTable(
        arrival_s=np.array([arrival for arrival, _ in frames]) * 1e-9,
        capture_s=np.array([frame.time_ns for _, frame in frames]) * 1e-9,
        frame_id=np.array([frame.frame_id for _, frame in frames], dtype=np.int64),
        depth_mm=np.stack(millimetres),
    )


def _to_millimetres(frame: DepthFrame) -> NDArray[np.uint16]:
    millimetres = np.rint(1e3 * frame.depth_unit_m * frame.depth.astype(np.float64))
    invalid = (frame.depth == NO_RETURN) | (millimetres > np.iinfo(np.uint16).max)
    return np.where(invalid, 0, millimetres).astype(np.uint16)


def _write(path: Path, columns: Sequence[str], table: Table) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", *columns])
        # repr keeps every bit of a float
        writer.writerows(
            [repr(t), *map(repr, row)] for t, row in zip(table.time_s.tolist(), table.values.tolist(), strict=True)
        )


def _write_depth(path: Path, depth: DepthTable) -> None:
    arrays: dict[str, Any] = {"t_arrival": depth.arrival_s, "frame_id": depth.frame_id, "depth": depth.depth_mm}
    if depth.capture_s is not None:
        arrays["t_capture"] = depth.capture_s
    np.savez_compressed(path, **arrays)


def _read_csv(path: Path) -> tuple[list[str], Floats]:
    try:
        with path.open(newline="") as file:
            header = [name.strip() for name in next(csv.reader(file), [])]
            rows = np.loadtxt(file, delimiter=",", ndmin=2, dtype=np.float64)
    except (OSError, ValueError) as error:
        raise RecordingError(f"cannot read {path}: {error}") from error
    if not header or header[0] != "t" or rows.shape[1] != len(header):
        raise RecordingError(f"{path}: the first line must name its {rows.shape[1]} columns, 't' first")
    if np.any(np.diff(rows[:, 0]) < 0):
        raise RecordingError(f"{path}: 't' runs backwards")
    return header, rows


def _read_optional(path: Path, columns: Sequence[str]) -> Table | None:
    if not path.exists():
        return None
    header, rows = _read_csv(path)
    missing = [name for name in columns if name not in header]
    if missing:
        raise RecordingError(f"{path}: column '{missing[0]}' is missing")
    order = [header.index(name) for name in columns]
    return Table(time_s=rows[:, 0], values=rows[:, order])


def _read_joints(path: Path, joints: list[str]) -> JointTable:
    header, rows = _read_csv(path)
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
    return JointTable(time_s=rows[:, 0], **signals)  # type: ignore[arg-type]


def _read_depth(path: Path) -> DepthTable | None:
    if not path.exists():
        return None
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            capture = arrays.get("t_capture")
            return DepthTable(
                arrival_s=arrays["t_arrival"], capture_s=capture, frame_id=arrays["frame_id"], depth_mm=arrays["depth"]
            )
    except Exception as error:  # a damaged archive fails in many ways
        raise RecordingError(f"cannot read {path}: {error}") from error
