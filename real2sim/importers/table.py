"""Reads a table of joints (text, Parquet or npz) as run logs: columns, units and order by a short description."""

import itertools
import math
import re
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from saltus.arrays import Floats
from saltus.errors import RecordingError, nearest_hint
from saltus.recordings.columns import names_in_archive, read_archive, read_parquet, read_text
from saltus.recordings.description import TableColumns
from saltus.recordings.rig_claims import RigClaims, SegmentClaim
from saltus.recordings.run_claims import CONTROL_DT, GAINS
from saltus.recordings.run_log import JOINT_SIGNALS, JointTable, RunLog, period_of
from saltus.robots.robot import JOINTS

Kind = Literal["bag", "text", "Parquet", "npz"]
BEGINNINGS: dict[bytes, Kind] = {
    b"#ROSBAG": "bag",
    b"\x89MCAP": "bag",
    b"SQLite format 3\0": "bag",
    b"PAR1": "Parquet",
    b"PK": "npz",
}
OF_OTHERS = {
    b"\x89HDF": "an HDF5 file (or a .mat of MATLAB)",
    b"MATLAB": "a .mat of MATLAB",
    b"\x93NUMPY": "a single array of numpy",
    b"\x80\x04": "a pickle of Python",
    b"\x80\x05": "a pickle of Python",
    b"\x80\x02": "a pickle of Python",
    b"\x1f\x8b": "compressed by gzip: unpack it first",
    b"\x28\xb5\x2f\xfd": "compressed by zstd: unpack it first",
    b"\xd0\xcf\x11\xe0": "an old workbook of Excel",
}
BAGS = (".bag", ".active", ".mcap", ".db3")
"""Endings of files that are refused as bags where they are none."""
KINDS = "a bag of ROS, a text of columns (CSV), Parquet or npz"


def kind_of(path: Path) -> Kind:
    """Kind of a recording.

    Raises:
        RecordingError: it is empty, cannot be read, or is of a kind that nothing reads; says what
            to make of it.
    """
    if path.is_dir():
        return "bag"
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError:
        return "text"  # its reader says why
    if path.suffix.lower() in BAGS:
        return "bag"  # also where it does not begin like one: the reader of bags says why
    if not head:
        raise RecordingError(f"{path} is empty")
    for beginning, what in OF_OTHERS.items():
        if head.startswith(beginning):
            raise RecordingError(
                f"{path} is {what}; `import` reads {KINDS}: numpy.savez(file, t=..., q=...) writes "
                "one"
            )
    kind: Kind = next(
        (kind for beginning, kind in BEGINNINGS.items() if head.startswith(beginning)), "text"
    )
    if kind == "npz":
        _check_npz(path)
    return kind


def _check_npz(path: Path) -> None:
    """Refuses archives of others, which begin alike."""
    if not zipfile.is_zipfile(path):
        return  # the reader says that it is cut off
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    if any(name.endswith(".npy") for name in names):
        return
    if "[Content_Types].xml" in names:
        raise RecordingError(f"{path} is a workbook of Excel: save its sheet as CSV")
    if any(name.endswith("data.pkl") for name in names):
        raise RecordingError(f"{path} is a file of torch: write its arrays with numpy.savez")
    raise RecordingError(f"{path} is a zip of other files; `import` reads {KINDS}: unpack it")


SLACK_S = 0.004  # largest difference between the time of a state and its row: two states
FAR = 20  # rows over which velocities are compared with angles: many states
WALK_S = 0.002  # standard deviation of that difference for a loop without synchronisation


def state_times(q: Floats, dq: Floats, row_s: float, state_s: float) -> Floats:
    """The likeliest time of the state in each row [s], from 0, on the grid of states (Viterbi algorithm).

    Args:
        q: Angles [rad], shape (rows, joints).
        dq: Velocities [rad/s], same shape; a common scale error is allowed.
        row_s: Time between rows.
        state_s: Time between states.
    """
    rate = 0.5 * (dq[1:] + dq[:-1]) / rate_scale(q, dq, row_s)
    weight = np.sum(rate**2, axis=1)
    passed = np.sum(np.diff(q, axis=0) * rate, axis=1) / np.maximum(weight, 1e-12)
    # the noise of the passed time falls with speed; its level is the distance to the nearest states
    # at high speeds
    fast = weight > np.median(weight)
    off = passed - state_s * np.rint(passed / state_s)
    # Median of a squared standard normal variable
    level = float(np.median(off[fast] ** 2 * weight[fast]) / 0.455)
    ticks = np.arange(-round(SLACK_S / state_s) - 1, round(SLACK_S / state_s) + 2)
    times = state_s * (np.floor(np.arange(len(q)) * row_s / state_s + 1e-9)[:, None] + ticks)
    prior = 0.5 * ((times - row_s * np.arange(len(q))[:, None]) / WALK_S) ** 2
    cost, came_from = prior[0], np.zeros(times.shape, dtype=np.int64)
    for row in range(1, len(q)):
        step = times[row][:, None] - times[row - 1]
        move = cost + 0.5 * (passed[row - 1] - step) ** 2 * weight[row - 1] / level
        move = np.where(step < 0, np.inf, move)
        came_from[row] = np.argmin(move, axis=1)
        cost = np.min(move, axis=1) + prior[row]
    best = np.empty(len(q), dtype=np.int64)
    best[-1] = np.argmin(cost)
    for row in range(len(q) - 1, 0, -1):
        best[row - 1] = came_from[row, best[row]]
    found = times[np.arange(len(q)), best]
    return np.asarray(found - found[0])


def rate_scale(q: Floats, dq: Floats, row_s: float) -> Floats:
    """Ratio of the velocities of each joint to the rate of its angles, shape (joints,)."""
    total = np.concatenate([np.zeros((1, q.shape[1])), np.cumsum(0.5 * (dq[1:] + dq[:-1]), axis=0)])
    far = min(FAR, len(q) - 1)
    moved, integral = q[far:] - q[:-far], row_s * (total[far:] - total[:-far])
    return np.asarray(
        np.sum(integral**2, axis=0) / np.maximum(np.sum(moved * integral, axis=0), 1e-12)
    )


def evenly(times_s: Floats, q: Floats, dq: Floats, at_s: Floats) -> tuple[Floats, Floats]:
    """Angles at other times, by a cubic through angles and velocities, and velocities, which are noisier, linearly.

    `dq` must be the rate of `q`.
    """
    fresh = np.concatenate([[True], np.diff(times_s) > 0])
    curve = CubicHermiteSpline(times_s[fresh], q[fresh], dq[fresh])
    at_s = np.clip(at_s, times_s[0], times_s[-1])
    rate = np.stack([np.interp(at_s, times_s[fresh], joint) for joint in dq[fresh].T], axis=1)
    return np.asarray(curve(at_s)), rate


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


def read_table(
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
        signals["q"], rate = evenly(times, signals["q"], rate / scale, time_s)
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
    """Times from the first row on [s], signals in SI units, shape (rows, joints) each, and notes."""
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
