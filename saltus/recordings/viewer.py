"""Derived messages in ROS 2's own types, so that a viewer shows a recording at once.

`/viewer/depth` (sensor_msgs/Image), `/viewer/tf` (tf2_msgs/TFMessage: world to base and to the yaw frame) and
`/viewer/heightmap` (sensor_msgs/PointCloud2 in the yaw frame). They hold nothing that the recorded topics do not.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus.wire import codec
from saltus.wire.codec import STORE, header
from saltus.wire.messages import DepthFrame, GroundTruth, Heightmap, Message

EVERY = 5  # one in five is enough for the eye: 10 Hz images, 20 Hz poses
FLOAT32 = 7  # sensor_msgs/msg/PointField


@dataclass(frozen=True, eq=False)
class ViewerMessage:
    """One derived message."""

    topic: str
    type_name: str
    payload: bytes


def derive(message: Message, sequence: int) -> Iterator[ViewerMessage]:
    """What a viewer needs of one recorded message; nothing for most."""
    if sequence % EVERY:
        return
    if isinstance(message, DepthFrame):
        yield _message("/viewer/depth", "sensor_msgs/msg/Image", _image(message))
    elif isinstance(message, Heightmap):
        yield _message("/viewer/heightmap", "sensor_msgs/msg/PointCloud2", _points(message))
    elif isinstance(message, GroundTruth):
        yield _message("/viewer/tf", "tf2_msgs/msg/TFMessage", _transforms(message))


def _message(topic: str, type_name: str, wire: Any) -> ViewerMessage:
    return ViewerMessage(topic, type_name, bytes(STORE.serialize_cdr(wire, type_name)))


def _image(frame: DepthFrame) -> Any:
    height, width = frame.depth.shape
    pixels = np.ascontiguousarray(frame.depth).view(np.uint8).reshape(-1)
    kind: Any = STORE.types["sensor_msgs/msg/Image"]
    return kind(header(frame.time_ns, "camera"), height, width, codec.ENCODING, 0, 2 * width, pixels)


def _points(heightmap: Heightmap) -> Any:
    kind: Any = STORE.types["sensor_msgs/msg/PointCloud2"]
    field: Any = STORE.types["sensor_msgs/msg/PointField"]
    points = np.stack([heightmap.x, 0 * heightmap.x, heightmap.height], axis=-1).astype(np.float32)
    fields = [field(name, 4 * i, FLOAT32, 1) for i, name in enumerate("xyz")]
    data = points.reshape(-1).view(np.uint8)
    return kind(header(heightmap.time_ns, "base_yaw"), 1, len(points), fields, False, 12, data.size, data, True)


def _transforms(truth: GroundTruth) -> Any:
    w, x, y, z = (float(v) for v in truth.quaternion_base_in_world)
    half_yaw = 0.5 * math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    yaw = np.array([math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw)])
    kind: Any = STORE.types["tf2_msgs/msg/TFMessage"]
    return kind([_transform(truth, "base", truth.quaternion_base_in_world), _transform(truth, "base_yaw", yaw)])


def _transform(truth: GroundTruth, frame: str, quaternion: NDArray[np.floating]) -> Any:
    kind: Any = STORE.types["geometry_msgs/msg/TransformStamped"]
    transform: Any = STORE.types["geometry_msgs/msg/Transform"]
    vector: Any = STORE.types["geometry_msgs/msg/Vector3"]
    rotation: Any = STORE.types["geometry_msgs/msg/Quaternion"]
    position = vector(*(float(v) for v in truth.position_base_in_world))
    w, x, y, z = (float(v) for v in quaternion)
    return kind(header(truth.time_ns, "world"), frame, transform(position, rotation(x, y, z, w)))
