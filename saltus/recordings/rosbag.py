"""Reads a recording of ROS (rosbag2 in SQLite or MCAP, or a bag of ROS 1) as the tables of a run log.

Times of measurements are the headers' stamps, or, where they are empty, those at which the bag received a message. All
count from the first message of joints: seconds since 1970 would leave doubles a quarter of a microsecond.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from tqdm import tqdm

from saltus.arrays import Floats
from saltus.errors import RecordingError, nearest_hint
from saltus.recordings.description import Topics
from saltus.recordings.realsense import DEPTH_ENCODINGS, PIXEL_CENTRE, nanoseconds, pixels, reading
from saltus.recordings.run_log import DepthTable, JointTable, RunLog, Table
from saltus.rotations import rotation_matrix

TYPES = {
    "joints": "sensor_msgs/msg/JointState",
    "commands": "sensor_msgs/msg/JointState",
    "imu": "sensor_msgs/msg/Imu",
    "base": "nav_msgs/msg/Odometry",
    "depth": "sensor_msgs/msg/Image",
    "camera_info": "sensor_msgs/msg/CameraInfo",
}
OLDEST_IMAGE_S = 10.0  # an image that is older at its arrival was stamped by another clock


@dataclass(frozen=True)
class _Received:
    """One message."""

    arrival_s: float
    time_s: float
    message: Any


_Messages = Sequence[_Received]


def read_rosbag(path: Path, topics: Topics, left_out: Sequence[str] = ()) -> tuple[RunLog, list[str]]:
    """Reads the joints and whatever else there is.

    Returns:
        A log whose `meta` has what the bag says: joints, control_dt, and intrinsics and rate of the camera. Notes on
        which topics were read, and what was left out.

    Raises:
        RecordingError: no bag; no topic of joints; a topic that is not there, of another type, or one of several.
    """
    types = get_typestore(Stores.ROS2_JAZZY)  # of a bag that does not hold its own
    with reading(path, "recording of ROS"), AnyReader([path], default_typestore=types) as reader:
        chosen = _choose(reader, path, topics)
        received = _receive(reader, path, chosen)
    notes = [", ".join(f"{part} from {topic}" for part, topic in chosen.items())]
    names, joints = _joints(chosen, received)
    depth = _depth(path, received.get("depth", ()), notes)
    told = received["commands"] if len(received.get("commands", ())) > 1 else received["joints"]
    meta: dict[str, Any] = {"joints": names, "control_dt": float(np.median(np.diff(_times(told))))}
    if depth is not None and "camera_info" in received:
        meta["camera"] = _camera(received["camera_info"][0].message, depth)
    log = RunLog(
        meta=meta,
        joints=joints,
        imu=_imu(received.get("imu", ()), notes),
        base=_base(received.get("base", ())),
        depth=depth,
    )
    return log, notes


def _choose(reader: AnyReader, path: Path, topics: Topics) -> dict[str, str]:
    """The topic of each part that is there."""
    types = {c.topic: c.msgtype for c in reader.connections if c.msgcount}
    if not types:
        raise RecordingError(f"{path} holds no messages")
    chosen: dict[str, str] = {}
    for part, given in vars(topics).items():
        if given is not None and types.get(given) != TYPES[part]:
            found = f"is of type {types[given]}" if given in types else f"is not there: {nearest_hint(given, types)}"
            raise RecordingError(f"{path}: {part} are to come from {given} ({TYPES[part]}), which {found}")
    taken = {given for given in vars(topics).values() if given is not None}
    for part, given in vars(topics).items():
        of_type = [topic for topic, kind in types.items() if kind == TYPES[part] and topic not in taken]
        if part == "depth" and len(of_type) > 1:
            of_type = [topic for topic in of_type if _first(reader, topic).encoding in DEPTH_ENCODINGS]
        if part == "camera_info" and len(of_type) > 1:
            of_type = [topic for topic in of_type if _folder(topic) == _folder(chosen.get("depth", ""))]
        if given is None and len(of_type) > 1:
            raise RecordingError(
                f"{path}: {part} may come from {' or '.join(sorted(of_type))}: name one with --topics.{part}"
            )
        if given or of_type:
            chosen[part] = given or of_type[0]
            taken.add(chosen[part])
    if "joints" not in chosen:
        raise _without_joints(path, types)
    return chosen


def _without_joints(path: Path, types: dict[str, str]) -> RecordingError:
    if path.suffix == ".bag" and TYPES["depth"] in types.values():
        return RecordingError(
            f"{path} holds images without joints and poses, with which `find` compares nothing: "
            f"`saltus render fit {path}` fits the camera's errors to them"
        )
    return RecordingError(f"{path} holds no {TYPES['joints']}; it has: {', '.join(sorted(types))}")


def _folder(topic: str) -> str:
    return topic.rpartition("/")[0]


def _first(reader: AnyReader, topic: str) -> Any:
    connections = [c for c in reader.connections if c.topic == topic]
    connection, _, raw = next(reader.messages(connections))
    return reader.deserialize(raw, connection.msgtype)


def _receive(reader: AnyReader, path: Path, chosen: dict[str, str]) -> dict[str, list[_Received]]:
    """Messages of each part."""
    part_of = {topic: part for part, topic in chosen.items()}
    connections = [c for c in reader.connections if c.topic in part_of]
    total = sum(c.msgcount for c in connections)
    received: dict[str, list[tuple[int, int, Any]]] = defaultdict(list)
    for connection, arrival_ns, raw in tqdm(
        reader.messages(connections), desc=path.name, total=total, disable=None, leave=False
    ):
        message: Any = reader.deserialize(raw, connection.msgtype)
        received[part_of[connection.topic]].append((arrival_ns, nanoseconds(message.header.stamp), message))
    arrival_ns, stamp_ns, _ = received["joints"][0]
    return {part: _timed(rows, stamp_ns or arrival_ns) for part, rows in received.items()}


def _timed(rows: Sequence[tuple[int, int, Any]], start_ns: int) -> list[_Received]:
    """Messages of one topic from their arrivals and stamps [ns]."""
    is_stamped = any(stamp for _, stamp, _ in rows)
    return [
        _Received(1e-9 * (arrival - start_ns), 1e-9 * ((stamp if is_stamped else arrival) - start_ns), each)
        for arrival, stamp, each in rows
    ]


def _joints(chosen: dict[str, str], received: dict[str, list[_Received]]) -> tuple[list[str], JointTable]:
    """Names of the joints, and rows from the first command on."""
    names = list(received["joints"][0].message.name)
    signals = _signals(received["joints"], chosen["joints"], names, ("q", "dq", "tau_est"))
    time_s = _times(received["joints"])
    if "q" not in signals or len(time_s) < 2:
        raise RecordingError(f"{chosen['joints']} has {'one message only' if 'q' in signals else 'no positions'}")
    if "commands" in received:
        told = _signals(received["commands"], chosen["commands"], names, ("q_des", "dq_des", "tau_ff"))
        sent_s = _times(received["commands"])
        if (np.diff(sent_s) < 0.0).any():
            raise RecordingError(f"{chosen['commands']}: time runs backwards")
        row = np.searchsorted(sent_s, time_s, side="right") - 1  # the command that is in force
        signals |= {signal: values[np.maximum(row, 0)] for signal, values in told.items()}
        kept = row >= 0
        if not kept.any():
            raise RecordingError(f"{chosen['commands']} begins after {chosen['joints']} has ended: two clocks?")
        time_s = time_s[kept]
        signals = {signal: values[kept] for signal, values in signals.items()}
    return names, JointTable(time_s=time_s, **signals)


def _signals(messages: _Messages, topic: str, names: Sequence[str], signals: Sequence[str]) -> dict[str, Floats]:
    """What joint messages hold of `signals`, in the order of `names`, shape (messages, joints) each."""
    fields = dict(zip(signals, ("position", "velocity", "effort"), strict=True))
    held = {signal: field for signal, field in fields.items() if len(getattr(messages[0].message, field))}
    rows = {signal: np.empty((len(messages), len(names))) for signal in held}
    orders: dict[tuple[str, ...], list[int]] = {}
    for row, each in enumerate(messages):
        own = tuple(each.message.name)
        if lacking := [name for name in names if own not in orders and name not in own]:
            raise RecordingError(f"{topic}: the message at {each.time_s:.3f} s lacks joint '{lacking[0]}'")
        order = orders.setdefault(own, [own.index(name) for name in names])
        for signal, field in held.items():
            values = getattr(each.message, field)
            if len(values) != len(own):
                raise RecordingError(f"{topic}: the message at {each.time_s:.3f} s lacks {field} of some joints")
            rows[signal][row] = values[order]
    return rows


def _times(messages: _Messages) -> Floats:
    return np.array([each.time_s for each in messages])


def _imu(messages: _Messages, notes: list[str]) -> Table | None:
    if not messages:
        return None
    if messages[0].message.orientation_covariance[0] == -1.0:  # sensor_msgs/Imu: there is no orientation
        notes.append("the IMU tells no orientation, and is left out")
        return None
    rows = [
        [*_wxyz(m.orientation), *_xyz(m.angular_velocity), *_xyz(m.linear_acceleration)]
        for m in (each.message for each in messages)
    ]
    return Table(time_s=_times(messages), values=np.array(rows))


def _base(messages: _Messages) -> Table | None:
    if not messages:
        return None
    poses = [each.message.pose.pose for each in messages]
    quaternions = np.array([_wxyz(pose.orientation) for pose in poses])
    own = np.array([_xyz(each.message.twist.twist.linear) for each in messages])
    velocity = (rotation_matrix(quaternions) @ own[..., None])[..., 0]  # nav_msgs/Odometry: in the child's frame
    positions = np.array([_xyz(pose.position) for pose in poses])
    return Table(time_s=_times(messages), values=np.concatenate([positions, quaternions, velocity], axis=1))


def _depth(path: Path, messages: _Messages, notes: list[str]) -> DepthTable | None:
    if not messages:
        return None
    arrival_s, capture_s = np.array([each.arrival_s for each in messages]), _times(messages)
    age_s = float(np.median(arrival_s - capture_s))
    if not 0.0 <= age_s <= OLDEST_IMAGE_S:
        notes.append(f"images were stamped {age_s:.3g} s before they came, by another clock, and are left out")
        return None
    return DepthTable(
        arrival_s=arrival_s,
        capture_s=capture_s,
        frame_id=np.arange(len(messages)),
        depth_mm=np.stack([pixels(each.message, path) for each in messages]),
    )


def _camera(info: Any, depth: DepthTable) -> dict[str, Any]:
    k = info.K if hasattr(info, "K") else info.k  # ROS 1 has capitals
    rate = 1.0 / float(np.median(np.diff(depth.arrival_s))) if len(depth.arrival_s) > 1 else 0.0
    fx, cx, fy, cy = (float(k[i]) for i in (0, 2, 4, 5))
    centre = {"cx": cx + PIXEL_CENTRE, "cy": cy + PIXEL_CENTRE}
    return {"fx": fx, "fy": fy, **centre, "width": int(info.width), "height": int(info.height), "rate": rate}


def _xyz(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _wxyz(quaternion: Any) -> tuple[float, float, float, float]:
    return quaternion.w, quaternion.x, quaternion.y, quaternion.z
