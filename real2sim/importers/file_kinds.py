"""The kind of somebody else's recording, by its first bytes, and even times for a robot that
measures at other times than its rows say.
"""

import zipfile
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from saltus.arrays import Floats
from saltus.errors import RecordingError

FileKind = Literal["bag", "text", "Parquet", "npz"]

BEGINNINGS: dict[bytes, FileKind] = {
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


def kind_of(path: Path) -> FileKind:
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
    kind: FileKind = next(
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
WALK_S = 0.002  # standard deviation of the former for a loop without synchronisation


def state_times(q: Floats, dq: Floats, row_s: float, state_s: float) -> Floats:
    """The likeliest time of the state in each row [s], from 0,
    on the grid of states (Viterbi algorithm).

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


def resample_joints(times_s: Floats, q: Floats, dq: Floats, at_s: Floats) -> tuple[Floats, Floats]:
    """Angles at other times, by a cubic through angles and velocities,
    and velocities, which are noisier, linearly.

    `dq` must be the rate of `q`.
    """
    fresh = np.concatenate([[True], np.diff(times_s) > 0])
    curve = CubicHermiteSpline(times_s[fresh], q[fresh], dq[fresh])
    at_s = np.clip(at_s, times_s[0], times_s[-1])
    rate = np.stack([np.interp(at_s, times_s[fresh], joint) for joint in dq[fresh].T], axis=1)
    return np.asarray(curve(at_s)), rate
