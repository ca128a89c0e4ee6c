"""Files of a run log."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from benchmarks.hidden_effects.motions import Segment
from benchmarks.hidden_effects.robot import JOINTS, Floats

IMU = ("qw", "qx", "qy", "qz", "gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y", "acc_z")
BASE = ("x", "y", "z", "qw", "qx", "qy", "qz", "vx", "vy", "vz")
FEET = ("f_FR", "f_FL", "f_RR", "f_RL")


@dataclass(kw_only=True)
class RunFiles:
    """Contents of a run log before it is written."""

    meta: dict[str, Any]
    tables: dict[str, dict[str, Floats]]
    """By name of the file ("joints", "imu", "base", "feet"), by name of the column."""
    depth: dict[str, np.ndarray] = field(default_factory=dict)


def joint_columns(t: Floats, measured: Floats, command: Floats) -> dict[str, Floats]:
    """Table of the joints; `measured` and `command` have the shape (rows, 12, 3)."""
    columns = {"t": t}
    signals = [
        ("q", measured, 0),
        ("dq", measured, 1),
        ("q_des", command, 0),
        ("dq_des", command, 1),
    ]
    for name, array, number in [*signals, ("tau_ff", command, 2), ("tau_est", measured, 2)]:
        for joint, label in enumerate(JOINTS):
            columns[f"{name}_{label}"] = np.ascontiguousarray(array[:, joint, number])
    return columns


def claim(
    *,
    base: str,
    kp: Floats,
    kd: Floats,
    control_dt: float,
    segments: tuple[Segment, ...],
    start_s: float,
) -> dict[str, Any]:
    """Claims that every meta.json makes of a log whose clock begins at `start_s`."""

    def shown(time_s: float) -> float:
        return round(round(time_s, 6) + start_s, 6)

    return {
        "schema": "saltus-run/1",
        "robot": "go1",
        "base": base,
        "joints": list(JOINTS),
        "kp": kp.tolist(),
        "kd": kd.tolist(),
        "control_dt": control_dt,
        "excitation": {
            "text": "a series of motions",
            "segments": [
                {
                    "name": s.name,
                    "t0": shown(s.start_s),
                    "t1": shown(s.end_s),
                    "condition": s.condition,
                }
                for s in segments
            ],
        },
        "terrain": "flat",
    }


def write(files: RunFiles, directory: Path) -> None:
    """Writes a run log.

    Tables of joints as Parquet without compression, so that its size tells nothing.
    """
    directory.mkdir(parents=True, exist_ok=True)
    for name, columns in files.tables.items():
        table = pa.table(
            {column: np.asarray(values, dtype=np.float64) for column, values in columns.items()}
        )
        if name == "joints":
            pyarrow.parquet.write_table(
                table, directory / "joints.parquet", compression="none", use_dictionary=False
            )
        else:
            pyarrow.csv.write_csv(table, directory / f"{name}.csv")
    if files.depth:
        np.savez(directory / "depth.npz", **files.depth)  # type: ignore[arg-type]
    (directory / "meta.json").write_text(json.dumps(files.meta, indent=1), encoding="utf-8")
