"""Run logs for the search: several runs read as one log, and logs cut into segments."""

import itertools
import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.errors import RecordingError, SaltusError
from saltus.real2sim.problem.problem import LogSegment
from saltus.recordings.run_claims import RigClaims, SegmentClaim, claimed_segments
from saltus.recordings.run_log import JointTable, RunLog, read_claims, read_run_log
from saltus.robots.loading import load_robot, reference_robot
from saltus.robots.robot import Robot
from saltus.robots.shipped import shipped_robots
from saltus.terrain.boxes import Boxes

PAUSE_S = 1.0  # between runs that are read as one; no state of joints or cameras lasts longer
# Length of segments in a log that names none and never rests: several periods of any motion
BLOCK_S = 5.0
QUIET_S = 0.5  # a rest of the commands this long separates two motions
SAME_COMMAND = 1e-3  # rad RMS: the commands of repeats are equal up to rounding

SHARED_CLAIMS = (
    "robot", "base", "joints", "kp", "kd", "control_dt", "terrain", "ground", "payload_kg",
    "payload_position",
    "motor_strength", "camera",
)  # fmt: skip
"""Claims that must be equal for runs to be read as one, because the simulator is built from
them."""
TABLES = ("joints", "imu", "base", "feet", "depth")
CLOCKS = ("time_s", "arrival_s", "capture_s")
"""Times that tables have."""


def load_rigs(paths: Sequence[Path]) -> list[RunLog]:
    """Reads runs.

    Those that claim the same rig are read as one log, in which they follow each other.

    Raises:
        RecordingError: no run given, one that is given twice, or one that cannot be read.
    """
    if not paths:
        raise RecordingError("name at least one run log")
    rigs: dict[str, list[tuple[Path, RunLog]]] = {}
    seen: set[Path] = set()
    for path in paths:
        if path.resolve() in seen:
            raise RecordingError(f"{path} is given twice: a run is no repeat of itself")
        seen.add(path.resolve())
        log = read_run_log(path)
        claims = json.dumps([log.meta.get(key) for key in SHARED_CLAIMS], sort_keys=True)
        rigs.setdefault(claims, []).append((path, replace(log, meta=_located(log.meta, path))))
    return [
        in_sequence([log for _, log in runs], [path.name for path, _ in runs])
        if len(runs) > 1
        else runs[0][1]
        for runs in rigs.values()
    ]


def in_sequence(logs: Sequence[RunLog], names: Sequence[str]) -> RunLog:
    """One log in which the given ones follow each other, with the claims of the first.

    Segments carry `names`.
    """
    return _join(
        [
            _shift(log, name, start)
            for log, name, start in zip(logs, names, shifts_s(logs), strict=True)
        ]
    )


def segments_of(log: RunLog) -> tuple[LogSegment, ...]:
    """Segments of a log: those that it names,
    else motions separated by rests, else blocks of equal length.

    Named segments are clipped to the time that the log covers. Unnamed ones with equal commands are
    repeats.
    """
    start, end = float(np.nanmin(log.joints.time_s)), float(np.nanmax(log.joints.time_s))
    named = [
        LogSegment(
            name=str(s["name"]),
            start_s=max(float(s["t0"]), start),
            end_s=min(float(s["t1"]), end),
            condition=str(s["condition"]),
        )
        for s in claimed_segments(log.meta)
    ]
    named = [segment for segment in named if segment.end_s > segment.start_s]
    return tuple(named) if named else _cut(log.joints)


def why_commands_unknown(log: RunLog) -> str:
    """Says why a log does not say what its drives were told; empty if it does."""
    if log.joints.q_des is None:
        return "no commands of the joints (q_des)"
    return "" if "kp" in log.meta else "meta.json claims no gains (kp, kd)"


def claimed_gains(log: RunLog) -> tuple[Floats, Floats]:
    """Claimed stiffness [Nm/rad] and damping [Nm s/rad] of the drives,
    shape (joints,) each, read-only.

    Of a log that claims them: `why_commands_unknown` says what is missing.
    """
    shape = (len(log.meta["joints"]),)
    kp, kd = (
        np.broadcast_to(np.asarray(log.meta[key], dtype=np.float64), shape) for key in ("kp", "kd")
    )
    return kp, kd


def gains_in_force(log: RunLog) -> tuple[Floats, Floats]:
    """Stiffness and damping of each command, shape (rows, joints) each:
    of the columns, or else as claimed.
    """
    own = (log.joints.kp, log.joints.kd)
    kp, kd = (
        np.broadcast_to(claimed, log.joints.q.shape) if column is None else column
        for column, claimed in zip(own, claimed_gains(log), strict=True)
    )
    return kp, kd


def has_changing_gains(log: RunLog) -> bool:
    """True where commands come with other gains than those that are claimed."""
    return any(
        np.any(own != claimed)
        for own, claimed in zip(gains_in_force(log), claimed_gains(log), strict=True)
    )


def claimed_model(log: RunLog) -> Robot | Path:
    """The model that a log names: a robot that Saltus ships, or the path of an MJCF of any kind."""
    name = str(log.meta["robot"])
    return load_robot(name) if name in shipped_robots() else Path(name)


def robot_of(log: RunLog) -> Robot:
    """The quadruped that a log names; `ModelError` where its MJCF is none."""
    return load_robot(str(log.meta["robot"]))


def robot_of_runs(runs: Sequence[Path]) -> Robot:
    """The robot of run logs that are not read yet.

    The default one where they cannot be read, or bring no quadruped.
    """
    for run in runs[:1]:
        with suppress(SaltusError):
            return load_robot(str(_located(read_claims(run), run)["robot"]))
    return reference_robot()


def quadruped_of(model: Robot | Path) -> Robot:
    """The robot to whose torque limits parameters of a saturation refer:
    for an MJCF that of the schema of run logs.
    """
    return model if isinstance(model, Robot) else reference_robot()


def torque_limits(model: Robot | Path) -> Floats:
    """Torques to which parameters of a saturation refer [Nm], shape (12,);
    of the schema where a robot has none.
    """
    limits = quadruped_of(model).torque_limit
    return np.where(np.isfinite(limits), limits, reference_robot().torque_limit)


def table_times(log: RunLog) -> dict[str, Floats]:
    """Times of the rows of each table that a log has; of images, when they arrived."""
    there = {name: table for name in TABLES if (table := getattr(log, name)) is not None}
    return {
        name: getattr(table, "arrival_s" if name == "depth" else "time_s")
        for name, table in there.items()
    }


def commanded_torque(log: RunLog) -> Floats:
    """The commands' part of the drives' torque:
    kp q_des + kd dq_des + tau_ff [Nm], shape (rows, joints).
    """
    (kp, kd), joints = gains_in_force(log), log.joints
    torque = kp * joints.commanded_q
    if joints.dq_des is not None:
        torque = torque + kd * joints.dq_des
    return torque if joints.tau_ff is None else torque + joints.tau_ff


def joint_rates(joints: JointTable) -> Floats:
    """Measured velocities, or the change of the angles [rad/s], shape (rows, joints)."""
    return joints.dq if joints.dq is not None else np.gradient(joints.q, joints.time_s, axis=0)


def drive_torque(log: RunLog) -> Floats:
    """Torque by the law of the drives on measured angles and velocities [Nm],
    shape (rows, joints).
    """
    kp, kd = gains_in_force(log)
    return np.asarray(commanded_torque(log) - kp * log.joints.q - kd * joint_rates(log.joints))


def boxes_of(log: RunLog) -> Boxes:
    """Boxes of the claimed terrain; none on flat ground."""
    terrain = log.meta.get("terrain")
    return Boxes.from_tables(terrain if isinstance(terrain, list) else [])


def interpolate_columns(at_s: Floats, time_s: Floats, values: Floats) -> Floats:
    """Linear interpolation of columns, shapes (...), (n,), (n, columns) -> (..., columns)."""
    place = np.interp(at_s, time_s, np.arange(len(time_s)))
    low = np.minimum(place.astype(np.int64), len(time_s) - 2)
    part = (place - low)[..., None]
    return np.asarray((1.0 - part) * values[low] + part * values[low + 1])


def _located(meta: RigClaims, directory: Path) -> RigClaims:
    """Claims with a path to the robot's model that does not depend on the folder."""
    robot = meta["robot"]
    if robot in shipped_robots():
        return meta
    model = directory / robot
    if not model.is_file():
        known = ", ".join(shipped_robots())
        raise RecordingError(
            f"{directory}: meta.json names robot {robot!r}: use {known}, or an MJCF beside "
            "meta.json"
        )
    return {**meta, "robot": str(model)}


def _cut(joints: JointTable) -> tuple[LogSegment, ...]:
    """Motions separated by rests of the commands.

    Blocks if the commands never rest or never move.
    """
    edges = _motions(joints)
    if len(edges) < 2:
        start, end = float(joints.time_s[0]), float(joints.time_s[-1])
        count = max(1, round((end - start) / BLOCK_S))
        edges = list(itertools.pairwise(np.linspace(start, end, count + 1).tolist()))
    motion, between = _motion(joints), rows_between(joints.time_s)
    stretches = [motion[between(start, end)] for start, end in edges]
    first_rows = np.array(
        [rows[0] if len(rows) else np.full(rows.shape[1], np.nan) for rows in stretches]
    )
    cut: list[LogSegment] = []
    for i, (start, end) in enumerate(edges):
        # Repeats differ by no more than this in any one value, by which thousands of motions are
        # told apart at once.
        most = SAME_COMMAND * np.sqrt(stretches[i].size)
        near = np.flatnonzero(np.abs(first_rows[:i, 0] - first_rows[i, 0]) < most)
        near = near[np.all(np.abs(first_rows[near] - first_rows[i]) < most, axis=1)]
        same = next((int(j) for j in near if _is_repeat(stretches[i], stretches[j])), i)
        cut.append(LogSegment(name=f"part{i}", start_s=start, end_s=end, condition=f"part{same}"))
    return tuple(cut)


def rows_between(time_s: Floats) -> Callable[[float, float], slice | NDArray[np.bool_]]:
    """Finds rows from a time on and before another [s].

    Those of a clock that never steps back as slices, at once.
    """
    if np.all(np.diff(time_s) >= 0.0):
        return lambda start, end: slice(*np.searchsorted(time_s, (start, end)).tolist())
    return lambda start, end: (time_s >= start) & (time_s < end)


def _motions(joints: JointTable) -> list[tuple[float, float]]:
    """Start and end [s] of each motion, with the rest after it, in which it settles."""
    changes = np.flatnonzero(np.any(np.diff(_motion(joints), axis=0) != 0, axis=1)) + 1
    if not len(changes):
        return []
    moving_s = joints.time_s[changes]
    starts = np.concatenate([[moving_s[0]], moving_s[1:][np.diff(moving_s) > QUIET_S]])
    ends = np.append(starts[1:], joints.time_s[-1])
    return [(float(a), float(b)) for a, b in zip(starts, ends, strict=True) if b > a]


def _motion(joints: JointTable) -> Floats:
    """Returns what tells one motion from another: commands, or else the angles themselves."""
    return joints.q if joints.q_des is None else joints.q_des


def _is_repeat(a: Floats, b: Floats) -> bool:
    rows = min(len(a), len(b))
    rest = np.concatenate([a[rows:], b[rows:]])
    # One of the two may end in a longer rest; two rows are rounding.
    if not rows or (len(rest) > 2 and np.any(np.ptp(rest, axis=0) > 0)):
        return False
    return bool(np.sqrt(np.mean((a[:rows] - b[:rows]) ** 2)) < SAME_COMMAND)


def shifts_s(logs: Sequence[RunLog]) -> list[float]:
    """Seconds by which the clock of each log must be set later so that one follows the other.

    A log then begins `PAUSE_S` after the one before, both by their joints.
    """
    shifts, end = [0.0], float(logs[0].joints.time_s[-1])
    for log in logs[1:]:
        shifts.append(end + PAUSE_S - float(log.joints.time_s[0]))
        end = float(log.joints.time_s[-1]) + shifts[-1]
    return shifts


def _shift(log: RunLog, name: str, shift_s: float) -> RunLog:
    """A copy of a run on a clock that is ahead by `shift_s`,
    with the run's name in the names of its segments.
    """
    named: list[SegmentClaim] = [
        {
            "name": f"{name}/{s.name}",
            "t0": s.start_s + shift_s,
            "t1": s.end_s + shift_s,
            "condition": s.condition,
        }
        for s in segments_of(log)
    ]
    tables = {name: _later(getattr(log, name), shift_s) for name in TABLES}
    return replace(log, meta=log.meta | {"segments": named}, **tables)


def _later(table: Any, shift_s: float) -> Any:
    """The rows of a table, if it is there, on a clock that is ahead by so much."""
    times = {name: getattr(table, name, None) for name in CLOCKS}
    return table and replace(
        table, **{name: own + shift_s for name, own in times.items() if own is not None}
    )


def _join(logs: Sequence[RunLog]) -> RunLog:
    """One log of runs on consecutive clocks, with the signals that all runs have."""
    segments = [segment for log in logs for segment in log.meta["segments"]]
    tables = {name: _joined([getattr(log, name) for log in logs]) for name in TABLES}
    return replace(logs[0], meta=logs[0].meta | {"segments": segments}, **tables)


def _joined(tables: Sequence[Any]) -> Any:
    """The rows of all tables that are there, with the columns that each of them has.

    Images are counted on.
    """
    there = [table for table in tables if table is not None]
    if not there:
        return None
    columns = {f.name: [getattr(table, f.name) for table in there] for f in fields(there[0])}
    ids = columns.get("frame_id", [])
    ends = np.cumsum([0, *(int(own[-1] - own[0]) + 1 for own in ids)])
    columns |= (
        {"frame_id": [own - own[0] + first for own, first in zip(ids, ends, strict=False)]}
        if ids
        else {}
    )
    lacking = {name for name, parts in columns.items() if any(part is None for part in parts)}
    return replace(
        there[0], **{n: None if n in lacking else np.concatenate(p) for n, p in columns.items()}
    )
