"""Reads a recording of ROS (rosbag2 in SQLite or MCAP, or a bag of ROS 1) as the tables of a run log.

Times of measurements are the headers' stamps, or, where they are empty, those at which the bag
received a message. All count from the first message of joints: seconds since 1970 would leave
doubles a quarter of a microsecond.
"""

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
from saltus.recordings.bag_files import opened
from saltus.recordings.bag_topics import COMMANDS, choose
from saltus.recordings.description import Topics
from saltus.recordings.images import (
    intrinsics,
    is_rectified,
    matrices_differ,
    millimetres,
    pixels_of,
)
from saltus.recordings.rig_claims import CameraClaim, RigClaims
from saltus.recordings.ros_types import (
    CameraInfo,
    Image,
    Imu,
    JointState,
    Odometry,
    Quaternion,
    Vector,
)
from saltus.recordings.run_log import DepthTable, JointTable, RunLog, Table, period_of
from saltus.rotations import rotation_matrix

OLDEST_IMAGE_S = 10.0  # an image that is older at its arrival was stamped by another clock
NANO = 10**9
CAMERAS_MAX = 16  # calibrations of a topic that are looked at; one that changes has a few


@dataclass(frozen=True)
class _Received:
    """One message, or what is kept of it."""

    arrival_s: float
    time_s: float
    message: Any


_Messages = Sequence[_Received]


def read_rosbag(
    path: Path, topics: Topics, left_out: Sequence[str] = (), size: tuple[int, int] | None = None,
    depth_unit_m: float | None = None,
) -> tuple[RunLog, list[str]]:  # fmt: skip
    """Reads the joints and whatever else there is.

    Args:
        path: File or folder.
        topics: Names of topics, where types do not tell.
        left_out: Signals and parts that the log is not to have.
        size: Width and height of the depth images that count, where there are several; by default
            the most frequent.
        depth_unit_m: Metres that one step of a depth image is; as ROS has it (REP 118), if None.

    Returns:
        A log whose `meta` has what the bag says: joints, control_dt, and intrinsics and rate of the
        camera. Notes on which topics were read, and what was left out.

    Raises:
        RecordingError: no bag; no topic of joints; a topic that is not there, of another type, or
            one of several.
    """
    notes: list[str] = []
    with opened(path) as reader:
        chosen = choose(reader, path, topics, left_out, notes)
        received = _receive(reader, path, chosen, notes, depth_unit_m)
    notes.insert(0, ", ".join(f"{part} from {topic}" for part, topic in chosen.items()))
    names, joints = _joints(chosen, received, left_out, notes)
    depth = _depth(path, received.pop("depth", []), size, notes)
    told = received["commands"] if len(received.get("commands", ())) > 1 else received["joints"]
    meta: RigClaims = {"joints": names, "control_dt": period_of(_times(told))}
    if depth is not None and "camera_info" in received:
        camera = _camera(
            [each.message for each in received["camera_info"]], chosen["depth"], depth, notes
        )
        if camera is not None:
            meta["camera"] = camera
    log = RunLog(
        meta=meta,
        joints=joints,
        imu=_imu(received.get("imu", ()), notes),
        base=_base(received.get("base", ())),
        depth=depth,
    )
    return log, notes


def _receive(
    reader: AnyReader,
    path: Path,
    chosen: dict[str, str],
    notes: list[str],
    depth_unit_m: float | None,
) -> dict[str, list[_Received]]:
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


def _joint_row(message: JointState) -> _Joints:
    values = (np.array(getattr(message, field), np.float64) for field in _Joints._fields[1:])
    return _Joints(tuple(map(sys.intern, message.name)), *values)


def _imu_row(message: Imu) -> Floats:
    """Orientation, rate and acceleration of an Imu; NaN for an orientation that it says it does not have."""
    has_none = message.orientation_covariance[0] == -1.0  # sensor_msgs/Imu
    turned = (np.nan,) * 4 if has_none else _wxyz(message.orientation)
    return np.array([*turned, *_xyz(message.angular_velocity), *_xyz(message.linear_acceleration)])


def _base_row(message: Odometry) -> Floats:
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

    def kept(self, image: Image) -> NDArray[np.uint16] | None:
        """Pixels in whole millimetres; None for an image that cannot be read."""
        try:
            pixels = _measured(millimetres(pixels_of(image), self._unit_m))
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


def _timed(rows: _Rows, start_ns: int) -> list[_Received]:
    """Messages of one topic, timed from a start on.

    Those of a topic without stamps by their arrivals.
    """
    has_stamps = any(stamp for _, stamp, _ in rows)
    return [
        _Received(
            1e-9 * (arrival - start_ns),
            1e-9 * ((stamp if has_stamps else arrival) - start_ns),
            each,
        )
        for arrival, stamp, each in rows
    ]


def _joints(
    chosen: dict[str, str],
    received: dict[str, list[_Received]],
    left_out: Sequence[str],
    notes: list[str],
) -> tuple[list[str], JointTable]:
    """Names of the joints, and rows from the first command on."""
    measured = _whole(received["joints"], chosen["joints"], notes)
    names = list(measured[0].message.name)
    signals = _signals(measured, chosen["joints"], names, ("q", "dq", "tau_est"), left_out)
    time_s = _times(measured)
    if "q" not in signals or len(time_s) < 2:
        raise RecordingError(
            f"{chosen['joints']} has {'one message only' if 'q' in signals else 'no positions'}"
        )
    if "commands" in received:
        commands = _whole(received["commands"], chosen["commands"], notes)
        told = _signals(commands, chosen["commands"], names, COMMANDS, left_out)
        sent_s = _times(commands)
        if (np.diff(sent_s) < 0.0).any():
            raise RecordingError(f"{chosen['commands']}: time runs backwards")
        row = np.searchsorted(sent_s, time_s, side="right") - 1  # the command that is in force
        signals |= {signal: values[np.maximum(row, 0)] for signal, values in told.items()}
        kept = row >= 0
        if not kept.any():
            raise RecordingError(
                f"{chosen['commands']} begins after {chosen['joints']} has ended: two clocks?"
            )
        time_s = time_s[kept]
        signals = {signal: values[kept] for signal, values in signals.items()}
    return names, JointTable(time_s=time_s, **signals)


def _whole(messages: _Messages, topic: str, notes: list[str]) -> _Messages:
    """The messages of a topic that name all joints of the longest: a gripper may send its own on the same topic."""
    named = Counter(each.message.name for each in messages)
    most = max(named, key=lambda names: (len(names), named[names]))
    whole = {names for names in named if {*most} <= {*names}}
    kept = [each for each in messages if each.message.name in whole]
    if len(kept) < len(messages):
        count = len(messages) - len(kept)
        notes.append(
            f"{topic}: {count} of {len(messages)} messages name fewer joints than others, and are "
            "left out"
        )
    return kept


def _signals(
    messages: _Messages,
    topic: str,
    names: Sequence[str],
    signals: Sequence[str],
    left_out: Sequence[str],
) -> dict[str, Floats]:
    """Values of `signals` in joint messages, in the order of `names`, shape (messages, joints) each.

    NaN stands for a joint that they do not name, as a gripper that takes commands of another kind.
    """
    fields = dict(zip(signals, ("position", "velocity", "effort"), strict=True))
    first = messages[0].message
    held = {
        s: field for s, field in fields.items() if s not in left_out and len(getattr(first, field))
    }
    rows = {signal: np.full((len(messages), len(names)), np.nan) for signal in held}
    places: dict[tuple[str, ...], tuple[list[int], list[int]]] = {}
    for row, each in enumerate(messages):
        own = each.message.name
        if own not in places:
            there = [place for place, name in enumerate(names) if name in own]
            places[own] = there, [own.index(names[place]) for place in there]
        ours, theirs = places[own]
        for signal, field in held.items():
            values = getattr(each.message, field)
            if len(values) != len(own):
                raise RecordingError(
                    f"{topic}: the message at {each.time_s:.3f} s has {len(own)} names and "
                    f"{len(values)} values of "
                    f"{field}; leave it out with leave_out"
                )
            rows[signal][row, ours] = values[theirs]
    return rows


def _times(messages: _Messages) -> Floats:
    return np.array([each.time_s for each in messages])


def _imu(messages: _Messages, notes: list[str]) -> Table | None:
    if not messages:
        return None
    values = np.stack([each.message for each in messages])
    if np.isnan(values[0, :4]).all() and np.isnan(values[:, :4]).all():
        notes.append("the IMU tells no orientation, and is left out")
        return None
    return Table(time_s=_times(messages), values=values)


def _base(messages: _Messages) -> Table | None:
    if not messages:
        return None
    values = np.stack([each.message for each in messages])
    # Into the world
    values[:, 7:] = (rotation_matrix(values[:, 3:7]) @ values[:, 7:, None])[..., 0]
    return Table(time_s=_times(messages), values=values)


def _depth(
    path: Path, messages: list[_Received], size: tuple[int, int] | None, notes: list[str]
) -> DepthTable | None:
    """Images of one size, taken before they came and by the clock of the bag."""
    if not messages:
        return None
    sizes = Counter(each.message.shape for each in messages)
    shape = sizes.most_common(1)[0][0] if size is None else size[::-1]
    if not sizes[shape]:
        there = ", ".join(f"{width}x{height}" for height, width in sizes)
        raise RecordingError(
            f"{path}: [claims.camera] is of {size[0]}x{size[1]} pixels, images are {there}"
            if size
            else ""
        )
    for (height, width), count in sizes.items():
        if (height, width) != shape:
            notes.append(
                f"{count} of {len(messages)} depth images are {width}x{height}, and are left out"
            )
    messages = [each for each in messages if each.message.shape == shape]
    arrival_s, capture_s = np.array([each.arrival_s for each in messages]), _times(messages)
    age_s = arrival_s - capture_s
    right = (age_s >= 0.0) & (age_s <= OLDEST_IMAGE_S)
    if not 0.0 <= np.median(age_s) <= OLDEST_IMAGE_S:
        median = float(np.median(age_s))
        notes.append(
            f"images were stamped {median:.3g} s before they came, by another clock, and are left "
            "out"
        )
        return None
    if not right.all():
        count = int(np.sum(~right))
        notes.append(
            f"{count} of {len(right)} depth images are stamped later than they came, or far "
            "earlier, and are left out"
        )
    stamped = bool(np.any(age_s))
    if not stamped:
        notes.append("images bear no stamps: how old they are when they come is not known")
    images: list[NDArray[np.uint16] | None] = [each.message for each in messages]
    messages.clear()
    depth = np.empty((int(right.sum()), *shape), np.uint16)
    for row, place in enumerate(np.flatnonzero(right)):
        depth[row], images[place] = images[place], None  # one by one: twice as many would not fit
    return DepthTable(
        arrival_s=arrival_s[right],
        capture_s=capture_s[right] if stamped else None,
        frame_id=np.arange(len(depth)),
        depth_mm=depth,
    )


def _camera(
    infos: Sequence[CameraInfo], topic: str, depth: DepthTable, notes: list[str]
) -> CameraClaim | None:
    """The first calibration that fits the images."""
    height, width = depth.depth_mm.shape[1:]
    rate = 1.0 / period_of(depth.arrival_s) if len(depth.arrival_s) > 1 else 0.0
    reason = ""
    for info in infos:
        try:
            found = intrinsics(info, width, height, rectified=is_rectified(topic))
        except MessageError as error:
            reason = reason or str(error)
            continue
        if matrices_differ(info):
            chosen, kind = (
                ("P", "rectified")
                if is_rectified(topic)
                else ("K", "raw, so that its lens distorts")
            )
            notes.append(f"K and P of the camera differ: {chosen} is taken, as {topic} is {kind}")
        return {
            "fx": found.fx,
            "fy": found.fy,
            "cx": found.cx,
            "cy": found.cy,
            "width": width,
            "height": height,
            "rate": rate,
        }
    notes.append(
        f"the camera is not known: {reason}; say fx, fy, cx, cy, width, height in [claims.camera]"
    )
    return None


def _xyz(vector: Vector) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _wxyz(quaternion: Quaternion) -> tuple[float, float, float, float]:
    return quaternion.w, quaternion.x, quaternion.y, quaternion.z
