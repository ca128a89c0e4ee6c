"""Writes small RealSense recordings, as the vendor's viewer would."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

WIDTH, HEIGHT, FOCAL_PX = 64, 48, 40.0
STREAM = "/device_0/sensor_0/Depth_0"
STORE = get_typestore(Stores.ROS1_NOETIC)
TYPES = STORE.types


def write_bag(path: Path, frames: int = 2, depth_mm: int = 600, stamps_ns: Sequence[int] | None = None) -> Path:
    """A wall in front of the camera, 30 images a second where nothing else is stamped."""
    stamps_ns = stamps_ns or [i * 33_333_333 for i in range(frames)]
    header = TYPES["std_msgs/msg/Header"]
    stamp = TYPES["builtin_interfaces/msg/Time"]
    matrix = np.array([FOCAL_PX, 0.0, WIDTH / 2 - 0.5, 0.0, FOCAL_PX, HEIGHT / 2 - 0.5, 0.0, 0.0, 1.0])
    region = TYPES["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    info = TYPES["sensor_msgs/msg/CameraInfo"](
        header(0, stamp(0, 0), ""), HEIGHT, WIDTH, "", np.zeros(5), matrix, np.eye(3).ravel(), np.zeros(12), 0, 0,
        region,
    )  # fmt: skip
    unit = TYPES["std_msgs/msg/Float32"](0.001)
    pixels = np.full(WIDTH * HEIGHT, depth_mm, "<u2").view(np.uint8)
    with Writer(path) as bag:
        topics = {
            f"{STREAM}/info/camera_info": info,
            "/device_0/sensor_0/option/Depth Units/value": unit,
        }
        for topic, message in topics.items():
            kind = message.__msgtype__
            bag.write(bag.add_connection(topic, kind, typestore=STORE), 0, STORE.serialize_ros1(message, kind))
        kind = "sensor_msgs/msg/Image"
        images = bag.add_connection(f"{STREAM}/image/data", kind, typestore=STORE)
        for i, time_ns in enumerate(stamps_ns):
            taken = stamp(*divmod(time_ns, 1_000_000_000))
            message = TYPES[kind](header(i, taken, ""), HEIGHT, WIDTH, "mono16", 0, 2 * WIDTH, pixels)
            bag.write(images, i * 33_333_333, STORE.serialize_ros1(message, kind))
    return path
