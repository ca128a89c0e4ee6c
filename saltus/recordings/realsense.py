"""Reads the depth stream of a RealSense recording, as the vendor's viewer and SDK write it.

That is a bag of ROS 1, or since 2026 a database of rosbag2 (.db3), in which texts say the
intrinsics and the unit.
"""

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from rosbags.highlevel import AnyReader

from saltus.errors import MessageError, RecordingError, shorten_names
from saltus.recordings.bag_files import open_bag
from saltus.recordings.ros_images import PixelIntrinsics, pixels_of, ros_intrinsics
from saltus.wire.depth_codec import CENTRE_MAX_PX, DEPTH_UNIT_MAX_M, FOCAL_MAX_PX
from saltus.wire.messages import DepthFrame

_LOG = logging.getLogger(__name__)
ENDINGS = (".bag", ".db3")
"""Endings of the names of such recordings."""
_IMAGE = "/image/data"
_DEFAULT_UNIT_M = 0.001  # librealsense's default depth unit of the D400 family
_ZSTD = b"\x28\xb5\x2f\xfd"  # a .db3 may hold compressed messages, each by itself
_UNPACKED_MAX = 2**28  # bytes: what the SDK's own reader accepts


@dataclass(frozen=True)
class _Camera:
    """A depth camera, as a recording says it once."""

    lens: PixelIntrinsics
    width: int
    height: int
    unit_m: float


def read_realsense(path: Path) -> Iterator[DepthFrame]:
    """Yields the depth frames of a recording in order of capture.

    Depth unit and intrinsics are the recording's own; where it does not state a unit, 1 mm is
    assumed and logged. `time_ns` is the camera's clock. A pixel of 0 is invalid, as in
    `DepthFrame`; 65535 is a plain distance here but would mean "nothing within range" there, so it
    becomes 65534.

    Raises:
        RecordingError: not a readable recording, or one without a depth stream or its intrinsics.
    """
    if not path.is_file():
        raise RecordingError(f"cannot read the RealSense recording {path}: there is no such file")
    with open_bag(path, "RealSense recording") as reader:
        yield from _frames(reader, path)


def _frames(reader: AnyReader, path: Path) -> Iterator[DepthFrame]:
    connections = [
        c for c in reader.connections if c.topic.endswith(_IMAGE) and "/Depth_" in c.topic
    ]
    if not connections:
        there = shorten_names(sorted({c.topic for c in reader.connections}))
        raise RecordingError(f"{path} holds no depth stream; it has: {there}")
    camera = _camera(reader, path, connections[0].topic.removesuffix(_IMAGE))
    for frame_id, (connection, _, raw) in enumerate(reader.messages(connections[:1])):
        image = reader.deserialize(_unpacked(raw), connection.msgtype)
        if (image.width, image.height) != (camera.width, camera.height):
            raise RecordingError(
                f"{path}: images of {image.width}x{image.height} do not match the intrinsics, "
                "which are for "
                f"{camera.width}x{camera.height}"
            )
        try:
            pixels = pixels_of(image)
        except MessageError as error:
            raise RecordingError(f"{path}: {error}") from error
        stamp = image.header.stamp
        yield DepthFrame(
            time_ns=int(stamp.sec) * 10**9 + int(stamp.nanosec),
            frame_id=frame_id,
            depth=np.minimum(pixels, 65534).astype(np.uint16),
            depth_unit_m=camera.unit_m,
            **vars(camera.lens),
        )


def _camera(reader: AnyReader, path: Path, stream: str) -> _Camera:
    sensor = stream.rsplit("/", 1)[0]
    option = _first(
        reader, f"{sensor}/option/Depth Units/value", f"{sensor}/option/Depth_Units/value"
    )
    if option is None:
        _LOG.warning("%s does not state its depth unit: taking %g m", path, _DEFAULT_UNIT_M)
    info = _first(reader, f"{stream}/info/camera_info", f"{stream}/camera_info")
    if info is None:
        raise RecordingError(f"{path} holds no intrinsics: '{stream}/info/camera_info' is missing")
    try:
        # The option is a float32, or a text: 0.001 reads as 0.0010000000475.
        unit = _DEFAULT_UNIT_M if option is None else round(float(option.data), 9)
        if hasattr(info, "data"):
            told = dict(pair.split("=", 1) for pair in info.data.rstrip(";").split(";"))
            width, height = int(told["width"]), int(told["height"])
            lens = PixelIntrinsics(
                *(float(told[key]) for key in ("fx", "fy")),
                *(0.5 + float(told[key]) for key in ("ppx", "ppy")),
            )
        else:
            width, height = int(info.width), int(info.height)
            lens = ros_intrinsics(info, width, height, rectified=False)
    except (MessageError, ValueError, KeyError) as error:
        raise RecordingError(
            f"{path}: its intrinsics or its depth unit cannot be read: {error}"
        ) from error
    for name, value, most in (
        ("depth unit", unit, DEPTH_UNIT_MAX_M), ("fx", lens.fx, FOCAL_MAX_PX),
        ("fy", lens.fy, FOCAL_MAX_PX),
        ("cx", lens.cx, CENTRE_MAX_PX), ("cy", lens.cy, CENTRE_MAX_PX),
    ):  # fmt: skip
        if not 0.0 < value <= most:
            raise RecordingError(
                f"{path} is damaged: its {name} is {value:g}, allowed are 0 to {most:g}"
            )
    return _Camera(lens, width, height, unit)


def _first(reader: AnyReader, *topics: str) -> Any:
    """The first message of the first of these topics that is there; None where none is."""
    for topic in topics:
        connections = [c for c in reader.connections if c.topic == topic and c.msgcount]
        if connections:  # an empty choice means all of them to the reader
            connection, _, raw = next(reader.messages(connections))
            return reader.deserialize(_unpacked(raw), connection.msgtype)
    return None


def _unpacked(raw: bytes | memoryview) -> bytes:
    data = bytes(raw)
    if not data.startswith(_ZSTD):
        return data
    with zstandard.ZstdDecompressor(max_window_size=_UNPACKED_MAX).stream_reader(data) as stream:
        return stream.read(_UNPACKED_MAX)
