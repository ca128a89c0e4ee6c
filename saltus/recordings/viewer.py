"""Derived messages in ROS 2's own types, so that a viewer shows a recording at once.

| topic | type | what |
|---|---|---|
| `/viewer/depth` | sensor_msgs/Image | one depth image in five |
| `/viewer/camera_info` | sensor_msgs/CameraInfo | pixel (u, v) looks through ((u - cx) / fx, (v - cy) / fy) |
| `/viewer/tf` | tf2_msgs/TFMessage | world to base and base_yaw, base to camera (z along the optical axis); 100 Hz |
| `/viewer/heightmap` | sensor_msgs/PointCloud2 | one in five, in the yaw frame |
| `/viewer/terrain` | visualization_msgs/MarkerArray | the boxes of the terrain, once |

They hold nothing that the recorded topics and the metadata do not. An image was taken at a time at which there is a
transform, so that each of its points has a place in the world.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rosbags.typesys import Stores, get_typestore

from saltus.robots.robot import Robot
from saltus.terrain.terrain import Terrain
from saltus.wire.codec import depth_on_the_wire, header
from saltus.wire.messages import DepthFrame, GroundTruth, Heightmap, Message

STORE = get_typestore(Stores.ROS2_JAZZY)
EVERY = 5  # one image or heightmap in five is enough for the eye
FLOAT32 = 7  # sensor_msgs/msg/PointField
CUBE = 1  # visualization_msgs/msg/Marker
GREY = (0.6, 0.63, 0.68, 1.0)


def definition_of(type_name: str) -> str:
    """The `ros2msg` schema text of a type that only viewers know."""
    return STORE.generate_msgdef(type_name, ros_version=2)[0]


@dataclass(frozen=True, eq=False)
class ViewerMessage:
    """One derived message."""

    topic: str
    type_name: str
    payload: bytes


class Viewer:
    """Derives what a viewer needs of the messages of one run."""

    def __init__(self, robot: Robot, terrain: Terrain) -> None:
        self._terrain = terrain
        self._camera = (robot.camera_position, _optical(robot.camera_pitch))

    def first(self) -> ViewerMessage:
        """What stands still: the terrain."""
        boxes = self._terrain.arrays
        markers = [
            _make(
                "visualization_msgs/msg/Marker",
                header=header(0, "world"), ns="terrain", id=i, type=CUBE, action=0,
                pose=_make("geometry_msgs/msg/Pose", position=_point(center), orientation=_quaternion(turned)),
                scale=_vector(size), color=_make("std_msgs/msg/ColorRGBA", **dict(zip("rgba", GREY, strict=True))),
                lifetime=_make("builtin_interfaces/msg/Duration", sec=0, nanosec=0), frame_locked=False,
                points=[], colors=[], texture_resource="", uv_coordinates=[], text="", mesh_resource="",
                texture=_make(
                    "sensor_msgs/msg/CompressedImage", header=header(0, ""), format="", data=np.zeros(0, np.uint8)
                ),
                mesh_file=_make("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, np.uint8)),
                mesh_use_embedded_materials=False,
            )
            for i, (center, size, turned) in enumerate(
                zip(boxes.center, 2.0 * boxes.half_size, boxes.quaternion, strict=True)
            )
        ]  # fmt: skip
        return _message("/viewer/terrain", _make("visualization_msgs/msg/MarkerArray", markers=markers))

    def derive(self, message: Message, sequence: int) -> Iterator[ViewerMessage]:
        """What a viewer needs of one recorded message, the `sequence`-th of its key; nothing for most."""
        if isinstance(message, GroundTruth):
            yield _message("/viewer/tf", self._transforms(message))
        if sequence % EVERY:
            return
        if isinstance(message, DepthFrame):
            wire = depth_on_the_wire(message)
            yield _message("/viewer/depth", wire.image)
            yield _message("/viewer/camera_info", wire.camera_info)
        elif isinstance(message, Heightmap):
            yield _message("/viewer/heightmap", _points(message))

    def _transforms(self, truth: GroundTruth) -> Any:
        w, x, y, z = (float(v) for v in truth.quaternion_base_in_world)
        half_yaw = 0.5 * math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        yaw = (math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw))
        position = truth.position_base_in_world
        transforms = [
            _transform(truth.time_ns, "world", "base", position, truth.quaternion_base_in_world),
            _transform(truth.time_ns, "world", "base_yaw", position, yaw),
            _transform(truth.time_ns, "base", "camera", *self._camera),
        ]
        return _make("tf2_msgs/msg/TFMessage", transforms=transforms)


def _optical(pitch: float) -> tuple[float, float, float, float]:
    """Quaternion of the camera frame in the base frame, of a camera that looks ahead and nose down by `pitch`."""
    c, s = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    a, b = 0.5 * (c - s), 0.5 * (c + s)  # of level optical axes (0.5, -0.5, 0.5, -0.5), turned about y
    return (a, -b, b, -a)


def _points(heightmap: Heightmap) -> Any:
    field: Any = STORE.types["sensor_msgs/msg/PointField"]
    points = np.stack([heightmap.x, 0 * heightmap.x, heightmap.height], axis=-1).astype(np.float32)
    fields = [field(name, 4 * i, FLOAT32, 1) for i, name in enumerate("xyz")]
    data = points.reshape(-1).view(np.uint8)
    return _make(
        "sensor_msgs/msg/PointCloud2", header=header(heightmap.time_ns, "base_yaw"), height=1, width=len(points),
        fields=fields, is_bigendian=False, point_step=12, row_step=data.size, data=data, is_dense=True,
    )  # fmt: skip


def _transform(time_ns: int, parent: str, child: str, position: ArrayLike, quaternion: ArrayLike) -> Any:
    return _make(
        "geometry_msgs/msg/TransformStamped",
        header=header(time_ns, parent),
        child_frame_id=child,
        transform=_make("geometry_msgs/msg/Transform", translation=_vector(position), rotation=_quaternion(quaternion)),
    )


def _vector(values: ArrayLike) -> Any:
    return STORE.types["geometry_msgs/msg/Vector3"](*np.asarray(values, np.float64).tolist())


def _point(values: ArrayLike) -> Any:
    return STORE.types["geometry_msgs/msg/Point"](*np.asarray(values, np.float64).tolist())


def _quaternion(wxyz: ArrayLike) -> Any:
    w, x, y, z = np.asarray(wxyz, np.float64).tolist()
    return STORE.types["geometry_msgs/msg/Quaternion"](x, y, z, w)


def _make(type_name: str, **fields: Any) -> Any:
    return STORE.types[type_name](**fields)


def _message(topic: str, wire: Any) -> ViewerMessage:
    return ViewerMessage(topic, wire.__msgtype__, bytes(STORE.serialize_cdr(wire, wire.__msgtype__)))
