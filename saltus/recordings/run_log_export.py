"""A recording of a run of Saltus as a run log,
which other tools read without knowing our messages.
"""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.errors import RecordingError
from saltus.recordings.recorded_file import is_recording
from saltus.recordings.recorder import RECORDING_FILE
from saltus.recordings.recording import Recording, read_recording
from saltus.recordings.run_claims import SCHEMA, CameraClaim, RigClaims, SegmentClaim, claim_of
from saltus.recordings.run_log import (
    DepthTable,
    JointTable,
    LogTable,
    RunLog,
    beside_its_command,
    write_run_log,
)
from saltus.robots.robot import JOINTS
from saltus.trial import Trial
from saltus.wire.messages import DepthFrame, GroundTruth, JointLog, RobotState
from saltus.wire.topics import CAMERA_LATENCY_S

NO_RETURN = 65535  # DepthFrame: nothing within range; a run log knows only "invalid", 0


def export_run_log(recording: Recording, directory: Path) -> None:
    """Writes a recording as a run log, with the robot's model beside it
    where Saltus does not ship that robot.

    Raises:
        RecordingError: the recording has no joint data, or the directory cannot be written.
    """
    write_run_log(_collect(recording), directory, recording.robot)


def as_run_log(run: Path, folder: Path) -> Path:
    """A run log as it is.

    Of a run of Saltus, by its folder or its recording, one that is written into `folder`.

    Raises:
        RecordingError: the recording cannot be read, has no joint data, or the log cannot be
            written.
    """
    if not is_run(run):
        return run
    export_run_log(read_recording(run / RECORDING_FILE if run.is_dir() else run), folder)
    return folder


def is_run(path: Path) -> bool:
    """True where it is the folder or the recording of a run of Saltus."""
    return (
        (path / RECORDING_FILE).is_file()
        if path.is_dir()
        else path.is_file() and is_recording(path)
    )


def _collect(recording: Recording) -> RunLog:
    logs = recording.of(JointLog)
    if not logs:
        raise RecordingError(f"{recording.path} has no joint data (controller/joints)")
    states = recording.of(RobotState)
    truths = recording.of(GroundTruth)
    frames = [(t, m) for t, _, m in recording.messages("camera/depth") if isinstance(m, DepthFrame)]
    imu = [
        (*m.quaternion_base_in_world, *m.angular_velocity_base, *m.acceleration_base)
        for m in states
    ]
    base = [
        (*m.position_base_in_world, *m.quaternion_base_in_world, *m.velocity_base_in_world)
        for m in truths
    ]
    return RunLog(
        meta=_meta(recording, logs, [frame for _, frame in frames], is_simulated=bool(truths)),
        joints=_joints(logs),
        imu=_table([m.time_ns for m in states], imu),
        base=_table([m.time_ns for m in truths], base),
        feet=_table([m.time_ns for m in truths], [m.foot_force for m in truths]),
        depth=_depth(frames),
    )


def _meta(
    recording: Recording, logs: list[JointLog], frames: list[DepthFrame], *, is_simulated: bool
) -> RigClaims:
    last = logs[-1].time_ns * 1e-9 + logs[-1].dt_s * len(logs[-1].position)
    segment: SegmentClaim = {
        "name": "run",
        "t0": logs[0].time_ns * 1e-9,
        "t1": last,
        "condition": "run",
    }
    meta: RigClaims = {
        "schema": SCHEMA,
        "robot": claim_of(recording.robot),
        "base": "free",
        "joints": list(JOINTS),
        "kp": np.median(np.concatenate([log.kp for log in logs]), axis=0).tolist(),
        "kd": np.median(np.concatenate([log.kd for log in logs]), axis=0).tolist(),
        "control_dt": logs[0].dt_s,
        "excitation": {"text": "a run of the whole stack", "segments": [segment]},
        "terrain": "flat",
        "notes": f"exported from {recording.path.name}",
    }
    if not recording.complete:
        meta["cut"] = "; ".join(recording.lost) or "it has no end"
    if recording.config is not None:
        if recording.terrain.edges_x.size:
            meta["terrain"] = recording.terrain.arrays.to_tables()
        meta["config"] = asdict(recording.config)
        if is_simulated:  # what a seed drew of body, drives and ground is known
            trial = Trial.draw(recording.config.seed)
            meta |= {"payload_kg": trial.payload_kg, "motor_strength": trial.motor_strength}
            meta["ground"] = {"friction": trial.friction}
    if frames:
        is_ideal = recording.config is not None and recording.config.profile == "ideal"
        meta["camera"] = _camera(recording, frames[0], 0.0 if is_ideal else CAMERA_LATENCY_S)
    return meta


def _camera(recording: Recording, frame: DepthFrame, latency_s: float) -> CameraClaim:
    height, width = frame.depth.shape
    robot, camera = recording.robot, recording.camera
    return {
        "fx": float(frame.fx),
        "fy": float(frame.fy),
        "cx": float(frame.cx),
        "cy": float(frame.cy),
        "width": width,
        "height": height,
        "position": robot.camera_position.tolist(),
        "pitch": robot.camera_pitch,
        "roll": robot.camera_roll,
        "yaw": robot.camera_yaw,
        "rate": camera.rate_hz,
        "latency": latency_s if camera.latency_s is None else camera.latency_s,
    }


def _joints(logs: list[JointLog]) -> JointTable:
    def rows(name: str) -> Floats:
        return np.concatenate([np.asarray(getattr(log, name), dtype=np.float64) for log in logs])

    return JointTable(
        time_s=_row_times(logs),
        q=rows("position"),
        dq=rows("velocity"),
        q_des=rows("position_desired"),
        dq_des=rows("velocity_desired"),
        tau_ff=rows("torque_feedforward"),
        tau_est=beside_its_command(rows("torque_estimated")),
        kp=rows("kp"),
        kd=rows("kd"),
    )


def _row_times(logs: list[JointLog]) -> Floats:
    """Times of all rows: even between the beginnings of two messages,
    which follow each other unevenly.
    """
    most = len(logs[0].position)
    starts_s, first = np.array([(log.time_ns * 1e-9, log.step * most) for log in logs]).T
    rows = np.concatenate([log.step * most + np.arange(len(log.position)) for log in logs])
    return np.interp(rows, first, starts_s) + logs[-1].dt_s * np.maximum(rows - first[-1], 0)


def _table(times_ns: list[int], rows: Sequence[object]) -> LogTable | None:
    if not times_ns:
        return None
    return LogTable(time_s=np.array(times_ns) * 1e-9, values=np.array(rows, dtype=np.float64))


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
