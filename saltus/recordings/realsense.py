"""Reads the depth stream of a RealSense recording (ROS 1 bag, as the vendor's viewer and SDK write it)."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_typestore

from saltus.errors import RecordingError
from saltus.wire.codec import CENTRE_MAX_PX, DEPTH_UNIT_MAX_M, FOCAL_MAX_PX
from saltus.wire.messages import DepthFrame

_LOG = logging.getLogger(__name__)
DEPTH_ENCODINGS = {"mono16": "u2", "16UC1": "u2", "32FC1": "f4"}
_IMAGE = "/image/data"
_DEFAULT_UNIT_M = 0.001  # librealsense's default depth unit of the D400 family
PIXEL_CENTRE = 0.5  # a camera_info's principal point counts from the centre of the first pixel, ours from its corner


def read_realsense(path: Path) -> Iterator[DepthFrame]:
    """Yields the depth frames of a recording in order of capture.

    Depth unit and intrinsics are the recording's own; where it does not state a unit, 1 mm is assumed and logged.
    `time_ns` is the camera's clock. A pixel of 0 is invalid, as in `DepthFrame`; 65535 is a plain distance here but
    would mean "nothing within range" there, so it becomes 65534.

    Raises:
        RecordingError: not a readable bag, or one without a depth stream or its intrinsics.
    """
    if not path.is_file():
        raise RecordingError(f"cannot read the RealSense recording {path}: there is no such file")
    with reading(path, "RealSense recording"), Reader(path) as reader:
        yield from _frames(reader, path)


@contextmanager
def reading(path: Path, kind: str) -> Iterator[None]:
    """Says of whatever goes wrong with a file that it cannot be read, or is none of its kind.

    Raises:
        RecordingError: with one line.
    """
    try:
        yield
    except RecordingError:
        raise
    except OSError as error:
        raise RecordingError(f"cannot read the {kind} {path}: {error}") from error
    except Exception as error:  # damaged bytes fail in many ways; all mean the same
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RecordingError(f"{path} is no {kind}, or damaged: {reason}") from error


def _frames(reader: Reader, path: Path) -> Iterator[DepthFrame]:
    store = get_typestore(Stores.ROS1_NOETIC)
    connections = [c for c in reader.connections if c.topic.endswith(_IMAGE) and "/Depth_" in c.topic]
    if not connections:
        raise RecordingError(f"{path} holds no depth stream; it has: {sorted(reader.topics)}")
    stream = connections[0].topic.removesuffix(_IMAGE)
    sensor = stream.rsplit("/", 1)[0]
    info = _first(reader, store, f"{stream}/info/camera_info")
    if info is None:
        raise RecordingError(f"{path} holds no intrinsics: '{stream}/info/camera_info' is missing")
    option = _first(reader, store, f"{sensor}/option/Depth Units/value")
    if option is None:
        _LOG.warning("%s does not state its depth unit: taking %g m", path, _DEFAULT_UNIT_M)
    # The option is a float32: 0.001 reads as 0.0010000000475.
    unit = _DEFAULT_UNIT_M if option is None else round(float(option.data), 9)
    for name, value, most in (
        ("depth unit", unit, DEPTH_UNIT_MAX_M), ("fx", info.K[0], FOCAL_MAX_PX), ("fy", info.K[4], FOCAL_MAX_PX),
        ("cx", info.K[2], CENTRE_MAX_PX), ("cy", info.K[5], CENTRE_MAX_PX),
    ):  # fmt: skip
        if not 0.0 < value <= most:
            raise RecordingError(f"{path} is damaged: its {name} is {value:g}, allowed are 0 to {most:g}")
    for frame_id, (connection, _, raw) in enumerate(reader.messages(connections[:1])):
        image = store.deserialize_ros1(raw, connection.msgtype)
        if (image.width, image.height) != (info.width, info.height):
            raise RecordingError(
                f"{path}: images of {image.width}x{image.height} do not match the intrinsics, which are for "
                f"{info.width}x{info.height}"
            )
        yield DepthFrame(
            time_ns=nanoseconds(image.header.stamp),
            frame_id=frame_id,
            depth=pixels(image, path),
            depth_unit_m=unit,
            fx=float(info.K[0]),
            fy=float(info.K[4]),
            cx=float(info.K[2]) + PIXEL_CENTRE,
            cy=float(info.K[5]) + PIXEL_CENTRE,
        )


def _first(reader: Reader, store: Any, topic: str) -> Any | None:
    """The first message of a topic; None where there is none."""
    connections = [c for c in reader.connections if c.topic == topic]
    if not connections:  # an empty choice means all of them to the reader
        return None
    connection, _, raw = next(reader.messages(connections))
    return store.deserialize_ros1(raw, connection.msgtype)


def nanoseconds(stamp: Any) -> int:
    """Of the time in a message's header."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def pixels(image: Any, path: Path) -> NDArray[np.uint16]:
    """Depth in an image message, shape (height, width): of 16 bits as it is, of 32 bits, which is in metres, in mm.

    Raises:
        RecordingError: another encoding, or an image of another size than it says.
    """
    if image.encoding not in DEPTH_ENCODINGS:
        raise RecordingError(f"{path}: depth encoding '{image.encoding}' is not one of {', '.join(DEPTH_ENCODINGS)}")
    kind = np.dtype(DEPTH_ENCODINGS[image.encoding]).newbyteorder(">" if image.is_bigendian else "<")
    used = kind.itemsize * image.width
    if image.step < used or len(image.data) != image.height * image.step:
        raise RecordingError(
            f"{path}: an image of {image.width}x{image.height} has {len(image.data)} bytes, {image.step} to a row"
        )
    rows = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step)
    depth = np.ascontiguousarray(rows[:, :used]).view(kind)
    if kind.kind == "f":
        depth = np.rint(1e3 * np.nan_to_num(depth, nan=0.0, posinf=0.0, neginf=0.0))
    return np.clip(depth, 0, 65534).astype(np.uint16)
