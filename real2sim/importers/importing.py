"""Makes run logs of recordings of others: bags of ROS and tables of joints."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from saltus.errors import RecordingError, nearest_hint
from saltus.real2sim.importers.table import read_table
from saltus.real2sim.screening.clock import clock_faults
from saltus.real2sim.screening.joints import unit_faults
from saltus.recordings.description import Description
from saltus.recordings.rosbag import read_rosbag
from saltus.recordings.run_claims import GAINS, SCHEMA, check_claims, claim_of
from saltus.recordings.run_log import JOINT_SIGNALS, RunLog, write_run_log
from saltus.robots.robot import JOINTS, Robot

WORTH_SAYING = ("q_des", "kp", "kd", "dq", "tau_est", "imu", "base", "depth")
"""Parts of a log whose absence makes effects untestable."""


@dataclass(frozen=True, kw_only=True)
class Imported:
    """What became of a recording."""

    logs: tuple[Path, ...]
    notes: tuple[str, ...]
    """What was read, and what is not in the logs."""


def import_recording(recording: Path, out: Path, description: Description, robot: Robot) -> Imported:
    """Writes a bag or a table as a run log, or as one for each leg into folders below `out`.

    Args:
        recording: Folder or file of a rosbag2, a ROS 1 bag, or a CSV.
        out: Folder of the log.
        description: What the recording does not say of itself.
        robot: The robot that was recorded. Joints are put in its order, and counted its way.

    Raises:
        RecordingError: it cannot be read; joints that the robot does not have; times that run backwards, or angles that
            no joint reaches; claims that cannot be.
    """
    notes: list[str] = []
    if recording.suffix == ".csv":
        if description.columns is None:
            raise RecordingError(f"{recording}: name its columns in the [columns] of a file, with --description")
        parts = read_table(recording, description.columns, description.joint_names)
    else:
        log, notes = read_rosbag(recording, description.topics)
        names = [description.joint_names.get(name, name) for name in log.meta["joints"]]
        parts = {"": replace(log, meta=log.meta | {"joints": names})}
    logs = {out / name: _completed(log, recording, description, robot) for name, log in parts.items()}
    for folder, log in logs.items():
        write_run_log(log, folder, robot)
    return Imported(logs=tuple(logs), notes=(*notes, *_lacking(next(iter(logs.values())), description)))


def _completed(log: RunLog, recording: Path, description: Description, robot: Robot) -> RunLog:
    """The log with all claims, in the robot's order; one that contradicts itself is refused."""
    claims = description.claims
    joints, log = _on_robot(log, robot)
    meta: dict[str, Any] = {
        "schema": SCHEMA,
        "robot": claim_of(robot),
        "base": "free",
        "terrain": "flat",
        "notes": f"imported from {recording.name}",
        **log.meta,
        "control_dt": round(log.meta["control_dt"], 9),  # [s], as differences of times leave digits behind the ns
        **claims,
        "joints": joints,
    }
    if "camera" in log.meta | claims:
        mount = {"position": robot.camera_position.tolist(), "pitch": robot.camera_pitch}
        meta["camera"] = mount | log.meta.get("camera", {}) | claims.get("camera", {})
    try:
        check_claims(meta)
    except RecordingError as error:
        raise RecordingError(f"{recording}: {error} (say it in [claims])") from error
    log = replace(log, meta=meta)
    faults = [fault for fault in (*clock_faults(log), *unit_faults(log)) if fault.is_fatal]
    if faults:
        raise RecordingError(f"{recording}: {faults[0].text}")
    return log


def _on_robot(log: RunLog, robot: Robot) -> tuple[list[str], RunLog]:
    """Names of the robot's joints in their order, and the log with columns in that order, counted its way."""
    own = [name.removesuffix("_joint") for name in log.meta["joints"]]
    for name in own:
        if name and name not in JOINTS:
            hint = f"{nearest_hint(name, JOINTS)}; say in [joint_names] which it is"
            raise RecordingError(f"the robot '{robot.name}' has no joint '{name}': {hint}")
    joints = [name for name in JOINTS if name in own]
    order = [own.index(name) for name in joints]
    sign = robot.joint_sign[[JOINTS.index(name) for name in joints]]
    signals = {name: values for name in JOINT_SIGNALS if (values := getattr(log.joints, name)) is not None}
    turned = {name: values[:, order] * (1.0 if name in GAINS else sign) for name, values in signals.items()}
    return joints, replace(log, joints=replace(log.joints, **turned))


def _lacking(log: RunLog, description: Description) -> list[str]:
    """What `find` will miss."""
    there = vars(log.joints) | log.meta | vars(log)  # claims before columns of gains, tables before claims
    absent = [part for part in WORTH_SAYING if there.get(part) is None]
    notes = [f"not in the log: {', '.join(absent)}; what needs them will be untestable"] if absent else []
    if "base" not in description.claims:
        notes.append('the robot is taken to have moved freely: if it was held, say base = "fixed" in [claims]')
    return [*notes, *(fault.text for fault in unit_faults(log))]
