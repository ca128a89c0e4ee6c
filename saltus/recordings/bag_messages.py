"""Messages of a bag as a run log keeps them, timed from the first message of the joints on."""

import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from tqdm import tqdm

from saltus.arrays import Floats
from saltus.depth import NOTHING
from saltus.errors import MessageError, RecordingError
from saltus.files import ARCHIVE_MAX
from saltus.recordings.ros_images import pixels_in_millimetres, pixels_of
from saltus.wire.ros_types import (
    AnyRosImage,
    RosImu,
    RosJointState,
    RosOdometry,
    RosQuaternion,
    RosVector,
)

NANO = 10**9
CAMERAS_MAX = 16  # calibrations of a topic that are looked at; one that changes has a few


@dataclass(frozen=True)
class BagMessage:
    """One message of a ROS bag, or what is kept of it."""

    arrival_s: float
    time_s: float
    message: Any


BagMessages = Sequence[BagMessage]


def receive_messages(
    reader: AnyReader,
    path: Path,
    chosen: dict[str, str],
    notes: list[str],
    depth_unit_m: float | None,
) -> dict[str, list[BagMessage]]:
    """Messages of each part; of images and calibrations what is kept of them."""
    part_of = {topic: part for part, topic in chosen.items()}
    connections = [c for c in reader.connections if c.topic in part_of]
    total = sum(c.msgcount for c in connections)
    received: dict[str, _Rows] = defaultdict(list)
    images = _Images(path, depth_unit_m)
    keep = KEPT | {"depth": images.kept}
    for connection, arrival_ns, raw in tqdm(
        reader.messages(connections), desc=path.name, total=total, disable=None, leave=False
    ):
        message = reader.deserialize(raw, connection.msgtype)
        part, stamp = part_of[connection.topic], message.header.stamp
        if part == "camera_info" and len(received[part]) >= CAMERAS_MAX:
            continue
        kept = keep[part](message)
        if kept is not None:
            received[part].append((arrival_ns, int(stamp.sec) * 10**9 + int(stamp.nanosec), kept))
    images.tell(notes)
    if not received["joints"]:
        raise RecordingError(
            f"{path}: {chosen['joints']} holds no messages: its metadata say more than there is"
        )
    kept_of = {part: _stamped(rows, chosen[part], notes) for part, rows in received.items()}
    arrival_ns, stamp_ns, _ = kept_of["joints"][0]
    return {part: _timed(rows, stamp_ns or arrival_ns) for part, rows in kept_of.items()}


class _Joints(NamedTuple):
    """The part of a JointState that is kept: an hour at 500 Hz has two million of them."""

    name: tuple[str, ...]
    position: Floats
    velocity: Floats
    effort: Floats


def _joint_row(message: RosJointState) -> _Joints:
    values = (np.array(getattr(message, field), np.float64) for field in _Joints._fields[1:])
    return _Joints(tuple(map(sys.intern, message.name)), *values)


def _imu_row(message: RosImu) -> Floats:
    """Orientation, rate and acceleration of an Imu;
    NaN for an orientation that it says it does not have.
    """
    has_none = message.orientation_covariance[0] == -1.0  # sensor_msgs/Imu
    turned = (np.nan,) * 4 if has_none else _wxyz(message.orientation)
    return np.array([*turned, *_xyz(message.angular_velocity), *_xyz(message.linear_acceleration)])


def _base_row(message: RosOdometry) -> Floats:
    """Position, orientation and the velocity in the child's own frame of an Odometry."""
    pose = message.pose.pose
    return np.array(
        [*_xyz(pose.position), *_wxyz(pose.orientation), *_xyz(message.twist.twist.linear)]
    )


KEPT: dict[str, Callable[[Any], object]] = {
    "joints": _joint_row, "commands": _joint_row, "imu": _imu_row, "base": _base_row,
    "camera_info": lambda info: info,
}  # fmt: skip
"""The part of a message that is kept, for each part of the log."""


class _Images:
    """Makes millimetres of images as they come, so that no more than these are held."""

    def __init__(self, path: Path, unit_m: float | None) -> None:
        self._path, self._unit_m = path, unit_m
        self._bytes = self._kept = 0
        self._refused: Counter[str] = Counter()

    def kept(self, image: AnyRosImage) -> NDArray[np.uint16] | None:
        """Pixels in whole millimetres; None for an image that cannot be read."""
        try:
            pixels = _measured(pixels_in_millimetres(pixels_of(image), self._unit_m))
        except MessageError as error:
            self._refused[str(error)] += 1
            return None
        self._kept += 1
        self._bytes += pixels.nbytes
        if self._bytes > ARCHIVE_MAX:
            raise RecordingError(
                f"{self._path}: its depth images take more than {ARCHIVE_MAX / 2**30:g} GiB: cut "
                "the bag, or say "
                'leave_out = ["depth"] in the description'
            )
        return pixels

    def tell(self, notes: list[str]) -> None:
        """Notes on images that could not be read; an error where none could."""
        for reason, count in self._refused.most_common():
            if not self._kept:
                raise RecordingError(
                    f"{self._path}: none of its depth images can be read: {reason}; or leave_out = "
                    f'["depth"]'
                )
            notes.append(f"{count} of {count + self._kept} depth images are left out: {reason}")


def _measured(depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Depth of a run log, which has no sign for "nothing within range" but that of no depth."""
    return np.where(depth == NOTHING, 0, depth).astype(np.uint16)


_Rows = list[tuple[int, int, object]]
"""Arrival and stamp [ns], and what is kept of a message."""


def _stamped(rows: _Rows, topic: str, notes: list[str]) -> _Rows:
    """Messages of one topic without those that bear no stamp, unless none has one.

    Simulated time begins at 0: a first stamp of 0 is one if others follow within a second.
    """
    if not any(stamp for _, stamp, _ in rows):
        return rows
    begin = next(place for place, (_, stamp, _) in enumerate(rows) if stamp)
    from_zero = rows[begin][1] < NANO
    kept = [row for place, row in enumerate(rows) if row[1] or (from_zero and place < begin)]
    if len(kept) < len(rows):
        notes.append(
            f"{topic}: {len(rows) - len(kept)} of {len(rows)} messages bear no stamp, and are left "
            "out"
        )
    return kept


def _timed(rows: _Rows, start_ns: int) -> list[BagMessage]:
    """Messages of one topic, timed from a start on.

    Those of a topic without stamps by their arrivals.
    """
    has_stamps = any(stamp for _, stamp, _ in rows)
    return [
        BagMessage(
            1e-9 * (arrival - start_ns),
            1e-9 * ((stamp if has_stamps else arrival) - start_ns),
            each,
        )
        for arrival, stamp, each in rows
    ]


def _xyz(vector: RosVector) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _wxyz(quaternion: RosQuaternion) -> tuple[float, float, float, float]:
    return quaternion.w, quaternion.x, quaternion.y, quaternion.z
