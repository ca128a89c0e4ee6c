"""Logs that are wrong as logs: nothing can be concluded from them but that."""

import numpy as np

from benchmarks.hidden_effects.robot import JOINTS
from benchmarks.hidden_effects.tables import RunFiles

DAMAGES = (
    "swapped_joints",
    "degrees",
    "sign_flip",
    "wrong_gains",
    "clock_backwards",
    "rows_dropped",
    "rows_doubled",
)


def damage(files: RunFiles, name: str, rng: np.random.Generator) -> str:
    """Spoils the table of joints of a log in place and says how."""
    joints = files.tables["joints"]
    if name == "swapped_joints":
        one, other = (
            str(joint)
            for joint in rng.choice([j for j in JOINTS if not j.endswith("hip")], 2, replace=False)
        )
        for signal in ("q", "dq"):
            a, b = joints[f"{signal}_{one}"], joints[f"{signal}_{other}"]
            joints[f"{signal}_{one}"], joints[f"{signal}_{other}"] = b, a
        return f"q and dq of {one} and {other} exchanged"
    if name == "degrees":
        for column in [c for c in joints if c.startswith(("q_", "dq_")) and "des" not in c]:
            joints[column] = np.rad2deg(joints[column])
        return "q and dq in degrees"
    if name == "sign_flip":
        joint = str(rng.choice([j for j in JOINTS if not j.endswith("hip")]))
        for signal in ("q", "dq"):
            joints[f"{signal}_{joint}"] = -joints[f"{signal}_{joint}"]
        return f"q and dq of {joint} have the wrong sign"
    if name == "wrong_gains":
        factor = float(rng.choice([0.4, 2.5]))
        files.meta["kp"] = [round(factor * kp, 3) for kp in files.meta["kp"]]
        return f"kp in the claim is {factor} times the drive's"
    rows = len(joints["t"])
    if name == "clock_backwards":
        at = int(rng.uniform(0.3, 0.7) * rows)
        joints["t"][at:] -= rng.uniform(0.5, 2.0)
        return "the clock jumps back"
    picked = _keep(name, rows, rng)
    files.tables["joints"] = {column: values[picked] for column, values in joints.items()}
    if name == "rows_doubled":
        return "a part of the rows is there twice"
    # rows are gone, but the clock was written as if they were not
    files.tables["joints"]["t"] = joints["t"][: len(picked)]
    return "rows are missing and the clock hides it"


def _keep(name: str, rows: int, rng: np.random.Generator) -> np.ndarray:
    if name == "rows_doubled":
        return np.repeat(np.arange(rows), 1 + (rng.uniform(size=rows) < 0.1))
    gone = np.zeros(rows, dtype=bool)
    for _ in range(12):
        start = int(rng.uniform(0.05, 0.9) * rows)
        gone[start : start + int(rng.uniform(20, 120))] = True
    return np.flatnonzero(~gone)
