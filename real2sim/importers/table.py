"""Reads a table of joints (text, Parquet or npz) as run logs:
columns, units and order by a short description.
"""

import itertools
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.errors import RecordingError, nearest_hint
from saltus.real2sim.importers.file_kinds import rate_scale, resample_joints, state_times
from saltus.recordings.file_columns import names_in_archive, read_archive, read_parquet, read_text
from saltus.recordings.recording_description import TableColumns
from saltus.recordings.run_claims import CONTROL_DT, GAINS, RigClaims, SegmentClaim
from saltus.recordings.run_log import JOINT_SIGNALS, JointTable, RunLog, period_of
from saltus.robots.robot import JOINTS

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
ANGLES = ("q", "dq", "q_des", "dq_des")
# After touching a stop: e^-3 of the touch is left at a stop of 340 Nm/rad (Go2) under a kd of 0.5
SETTLED_S = 0.25
SHORTEST_S = 1.0  # of a stretch: the first 0.25 s of a replay only settle
SEGMENT_S = 5.0  # of what a stretch is cut into: several periods of any motion
READERS = {"text": read_text, "Parquet": read_parquet, "npz": read_archive}
"""The reader of each kind of table."""
LOG = "{log}"
"""In a name of [columns]: what tells the logs of one archive apart."""


def read_log_table(
    path: Path,
    kind: str,
    columns: TableColumns,
    joint_names: dict[str, str],
    left_out: Iterable[str] = (),
) -> tuple[dict[str, RunLog], list[str]]:
    """The logs of a table by their names, and notes.

    There is one without a name, one for each that an archive holds, or, where joints lean on stops,
    one for each leg that moves freely for a while. `meta` of a log has joints, by their names in
    `joint_names`, control_dt, and segments where stretches are left out.

    Args:
        path: A table of a kind of `READERS`.
        kind: Which.
        columns: What stands where.
        joint_names: The table's name of a joint, and that of the robot.
        left_out: Signals that are not read.

    Raises:
        RecordingError: a column that is missing or holds text, or a description that does not say
            enough.
    """
    without: dict[str, Any] = dict.fromkeys({*left_out} & {*JOINT_SIGNALS})
    columns = replace(_with_joints(columns, joint_names), **without)
    if LOG not in columns.q:
        return _read_one(path, kind, columns, joint_names)
    found = re.compile(
        re.escape(columns.q.partition(LOG)[0]) + "(.+)" + re.escape(columns.q.partition(LOG)[2])
    )
    if kind != "npz":
        raise RecordingError(
            f'[columns] q = "{columns.q}": {LOG} tells apart the logs of an npz, and {path} is none'
        )
    names = sorted(match[1] for name in names_in_archive(path) if (match := found.fullmatch(name)))
    if not names:
        raise RecordingError(f'{path}: no array is named like [columns] q = "{columns.q}"')
    logs: dict[str, RunLog] = {}
    notes: list[str] = []
    for name in names:
        own: dict[str, Any] = {
            key: value.replace(LOG, name)
            for key, value in vars(columns).items()
            if isinstance(value, str)
        }
        parts, told = _read_one(path, kind, replace(columns, **own), joint_names)
        logs |= {f"{name}/{part}".rstrip("/"): log for part, log in parts.items()}
        notes += [note for note in told if note not in notes]
    return logs, notes


def _read_one(
    path: Path, kind: str, columns: TableColumns, joint_names: dict[str, str]
) -> tuple[dict[str, RunLog], list[str]]:
    joints = [joint_names.get(name, name) for name in columns.joints]
    time_s, signals, notes = _read(path, kind, columns)
    return _logs(path, columns, joints, time_s, signals), notes


def _logs(
    path: Path,
    columns: TableColumns,
    joints: Sequence[str],
    time_s: Floats,
    signals: dict[str, Floats],
) -> dict[str, RunLog]:
    if len(time_s) < 2:
        raise RecordingError(f"{path} has one row only")
    row_s = 1.0 / columns.rate_hz if columns.rate_hz is not None else period_of(time_s)
    low, high, _ = CONTROL_DT
    if not low <= abs(row_s) <= high:  # times that run backwards are refused as such
        key = "time_unit" if columns.time is not None else "rate_hz"
        raise RecordingError(
            f"{path}: rows are {row_s:g} s apart, {low:g} to {high:g} s is allowed; check "
            f"[columns] {key}"
        )
    if columns.states_every_s is not None:
        rate = signals.get("dq")
        if rate is None or columns.rate_hz is None:
            raise RecordingError(
                "[columns] states_every_s is for rows without times: it needs rate_hz and dq"
            )
        times = state_times(signals["q"], rate, row_s, columns.states_every_s)
        scale = rate_scale(signals["q"], rate, row_s)
        signals["q"], rate = resample_joints(times, signals["q"], rate / scale, time_s)
        signals["dq"] = scale * rate
    usual = {gain: np.median(signals[gain], axis=0).tolist() for gain in GAINS if gain in signals}
    meta = cast(RigClaims, {"joints": joints, "control_dt": row_s, **usual})
    if not columns.moves_freely:
        return {"": RunLog(meta=meta, joints=JointTable(time_s=time_s, **signals))}
    logs = {}
    for leg in dict.fromkeys(name.partition("_")[0] for name in joints if name):
        own = [i for i, name in enumerate(joints) if name.partition("_")[0] == leg]
        leaning = _leaning(signals["q"][:, own], [joints[i] for i in own], columns.moves_freely)
        if stretches := _stretches(leaning, row_s):
            kept = np.concatenate([np.arange(first, end) for first, end in stretches])
            part = {signal: values[kept][:, own] for signal, values in signals.items()}
            claims: dict[str, object] = {
                "joints": [joints[i] for i in own],
                "segments": _segments(stretches, row_s),
            }
            claims |= {gain: [values[i] for i in own] for gain, values in usual.items()}
            table = JointTable(time_s=time_s[kept], **part)
            logs[leg] = RunLog(meta=cast(RigClaims, meta | claims), joints=table)
    if not logs:
        raise RecordingError(f"{path}: no leg moves freely for {SHORTEST_S:g} s")
    return logs


def _with_joints(columns: TableColumns, joint_names: dict[str, str]) -> TableColumns:
    """The columns with the table's names of all joints.

    Refuses what [joint_names] has beside them.
    """
    own = {joint.removesuffix("_joint"): name for name, joint in joint_names.items()}
    joints = columns.joints or tuple(own.get(joint, joint) for joint in JOINTS)
    for name, joint in joint_names.items():
        if joint and name not in joints:
            hint = nearest_hint(name, joints) if columns.joints else nearest_hint(joint, JOINTS)
            raise RecordingError(
                f"[joint_names] '{name}' = '{joint}' names no joint of the table: {hint}"
            )
    return replace(columns, joints=joints)


def _read(
    path: Path, kind: str, columns: TableColumns
) -> tuple[Floats, dict[str, Floats], list[str]]:
    """Times from the first row on [s], signals in SI units,
    shape (rows, joints) each, and notes.
    """
    if (columns.time is None) == (columns.rate_hz is None):
        raise RecordingError(
            "[columns] needs either time, a column, or rate_hz, of rows that are evenly spaced"
        )
    named = {
        signal: _names(columns, signal, kind)
        for signal in JOINT_SIGNALS
        if getattr(columns, signal) is not None
    }
    wanted = [
        *([columns.time] if columns.time is not None else []),
        *itertools.chain(*named.values()),
    ]
    read = READERS[kind](path, wanted)
    signals = {
        signal: _together(path, read.values, names, columns) for signal, names in named.items()
    }
    for signal in set(ANGLES) & set(signals) if columns.angle == "deg" else ():
        signals[signal] = math.radians(1.0) * signals[signal]
    rows = {name: len(values) for name, values in read.values.items()}
    if len(set(rows.values())) > 1:
        raise RecordingError(
            f"{path}: columns of unequal length: "
            + ", ".join(f"{n} {rows[n]}" for n in list(rows)[:4])
        )
    if columns.time is not None:
        time = read.values[columns.time].ravel()
        return (
            np.asarray(SECONDS[columns.time_unit] * (time - time[0]), dtype=np.float64),
            signals,
            list(read.notes),
        )
    assert columns.rate_hz is not None  # noqa: S101 - as checked above
    if not columns.rate_hz > 0.0:
        raise RecordingError(f"[columns] rate_hz = {columns.rate_hz:g}: it must be more than 0")
    return (
        np.arange(len(signals["q"])) * np.float64(1.0 / columns.rate_hz),
        signals,
        list(read.notes),
    )


def _names(columns: TableColumns, signal: str, kind: str) -> list[str]:
    """Names of a signal's columns, one for each joint; or one for all of them."""
    pattern = getattr(columns, signal)
    try:
        names = [
            pattern.format(joint=joint, number=number)
            for number, joint in enumerate(columns.joints)
        ]
    except (KeyError, IndexError, ValueError) as error:
        raise RecordingError(
            f'[columns] {signal} = "{pattern}": within {{}} go joint or number'
        ) from error
    if len(set(names)) == 1 < len(names) and kind != "npz" and signal not in GAINS:
        raise RecordingError(
            f'[columns] {signal} = "{pattern}" names one column for all joints: put {{number}} or '
            f"{{joint}} in"
        )
    return list(dict.fromkeys(names))


def _together(
    path: Path, values: dict[str, Floats], names: Sequence[str], columns: TableColumns
) -> Floats:
    """A signal of all joints, shape (rows, joints), out of its columns."""
    count = len(columns.joints)
    whole = values[names[0]]
    if len(names) == 1 and whole.ndim == 2:
        if whole.shape[1] != count:
            raise RecordingError(
                f"{path}: '{names[0]}' is of {whole.shape[1]} joints, [columns] joints names "
                f"{count}"
            )
        return whole
    if wrong := [name for name in names if values[name].ndim != 1]:
        raise RecordingError(
            f"{path}: '{wrong[0]}' has many columns, of which [columns] may name the whole alone"
        )
    if len(names) not in (1, count):
        raise RecordingError(
            f"{path}: {len(names)} columns for {count} joints: two joints have one name"
        )
    return np.stack([values[name] for name in names] * (count // len(names)), axis=1)


def _leaning(
    q: Floats, joints: Sequence[str], ranges: dict[str, tuple[float, float]]
) -> NDArray[np.bool_]:
    """Rows in which a joint leans on a stop."""
    leaning = np.zeros(len(q), dtype=bool)
    for ending, (low, high) in ranges.items():
        own = q[:, [name.endswith(ending) for name in joints]]
        leaning |= ((own < low) | (own > high)).any(axis=1)
    return leaning


def _stretches(leaning: NDArray[np.bool_], row_s: float) -> list[tuple[int, int]]:
    """First row and end of the parts that no stop disturbs, cut into segments."""
    free = np.ones(len(leaning) + 2, dtype=bool)
    free[[0, -1]] = False
    for row in np.flatnonzero(leaning):
        free[row + 1 : row + 2 + round(SETTLED_S / row_s)] = False
    free[-1] = False
    edges = np.flatnonzero(np.diff(free.astype(int)))
    cut: list[tuple[int, int]] = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        parts = max(1, round((end - first) * row_s / SEGMENT_S))
        inner = np.linspace(first, end, parts + 1).astype(int).tolist()
        if (end - first) * row_s >= SHORTEST_S:
            cut += itertools.pairwise(inner)
    return cut


def _segments(stretches: list[tuple[int, int]], row_s: float) -> list[SegmentClaim]:
    return [
        {"name": f"part {i}", "t0": first * row_s, "t1": end * row_s, "condition": "run"}
        for i, (first, end) in enumerate(stretches)
    ]
