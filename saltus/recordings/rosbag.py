"""Reads a recording of ROS (rosbag2 in SQLite or MCAP, or a bag of ROS 1)
as the tables of a run log.

Times of measurements are the headers' stamps, or, where they are empty, those at which the bag
received a message. All count from the first message of joints: seconds since 1970 would leave
doubles a quarter of a microsecond.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.errors import MessageError, RecordingError
from saltus.recordings.bag_files import open_bag
from saltus.recordings.bag_messages import BagMessage, BagMessages, receive_messages
from saltus.recordings.bag_topics import COMMANDS, choose_topics
from saltus.recordings.recording_description import BagTopics
from saltus.recordings.ros_images import is_rectified, matrices_differ, ros_intrinsics
from saltus.recordings.run_claims import CameraClaim, RigClaims
from saltus.recordings.run_log import DepthTable, JointTable, LogTable, RunLog, period_of
from saltus.rotations import rotation_matrix
from saltus.wire.ros_types import RosCameraInfo

OLDEST_IMAGE_S = 10.0  # an image that is older at its arrival was stamped by another clock


def read_rosbag(
    path: Path, topics: BagTopics, left_out: Sequence[str] = (),
    size: tuple[int, int] | None = None,
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
    with open_bag(path) as reader:
        chosen = choose_topics(reader, path, topics, left_out, notes)
        received = receive_messages(reader, path, chosen, notes, depth_unit_m)
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


def _joints(
    chosen: dict[str, str],
    received: dict[str, list[BagMessage]],
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


def _whole(messages: BagMessages, topic: str, notes: list[str]) -> BagMessages:
    """The messages of a topic that name all joints of the longest:
    a gripper may send its own on the same topic.
    """
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
    messages: BagMessages,
    topic: str,
    names: Sequence[str],
    signals: Sequence[str],
    left_out: Sequence[str],
) -> dict[str, Floats]:
    """Values of `signals` in joint messages, in the order of `names`,
    shape (messages, joints) each.

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


def _times(messages: BagMessages) -> Floats:
    return np.array([each.time_s for each in messages])


def _imu(messages: BagMessages, notes: list[str]) -> LogTable | None:
    if not messages:
        return None
    values = np.stack([each.message for each in messages])
    if np.isnan(values[0, :4]).all() and np.isnan(values[:, :4]).all():
        notes.append("the IMU tells no orientation, and is left out")
        return None
    return LogTable(time_s=_times(messages), values=values)


def _base(messages: BagMessages) -> LogTable | None:
    if not messages:
        return None
    values = np.stack([each.message for each in messages])
    # Into the world
    values[:, 7:] = (rotation_matrix(values[:, 3:7]) @ values[:, 7:, None])[..., 0]
    return LogTable(time_s=_times(messages), values=values)


def _depth(
    path: Path, messages: list[BagMessage], size: tuple[int, int] | None, notes: list[str]
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
    infos: Sequence[RosCameraInfo], topic: str, depth: DepthTable, notes: list[str]
) -> CameraClaim | None:
    """The first calibration that fits the images."""
    height, width = depth.depth_mm.shape[1:]
    rate = 1.0 / period_of(depth.arrival_s) if len(depth.arrival_s) > 1 else 0.0
    reason = ""
    for info in infos:
        try:
            found = ros_intrinsics(info, width, height, rectified=is_rectified(topic))
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
