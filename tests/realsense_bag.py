"""Writes small RealSense recordings, as the vendor's viewer would."""

import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

WIDTH, HEIGHT, FOCAL_PX = 64, 48, 40.0
STREAM = "/device_0/sensor_0/Depth_0"
STORE = get_typestore(Stores.ROS1_NOETIC)
TYPES = STORE.types


def write_bag(
    path: Path, frames: int = 2, depth_mm: int = 600, stamps_ns: Sequence[int] | None = None
) -> Path:
    """A wall in front of the camera, 30 images a second where nothing else is stamped."""
    stamps_ns = stamps_ns or [i * 33_333_333 for i in range(frames)]
    header = TYPES["std_msgs/msg/Header"]
    stamp = TYPES["builtin_interfaces/msg/Time"]
    matrix = np.array(
        [FOCAL_PX, 0.0, WIDTH / 2 - 0.5, 0.0, FOCAL_PX, HEIGHT / 2 - 0.5, 0.0, 0.0, 1.0]
    )
    region = TYPES["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    info = TYPES["sensor_msgs/msg/CameraInfo"](
        header(0, stamp(0, 0), ""), HEIGHT, WIDTH, "", np.zeros(5), matrix, np.eye(3).ravel(),
        np.zeros(12), 0, 0,
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
            bag.write(
                bag.add_connection(topic, kind, typestore=STORE),
                0,
                STORE.serialize_ros1(message, kind),
            )
        kind = "sensor_msgs/msg/Image"
        images = bag.add_connection(f"{STREAM}/image/data", kind, typestore=STORE)
        for i, time_ns in enumerate(stamps_ns):
            taken = stamp(*divmod(time_ns, 1_000_000_000))
            message = TYPES[kind](
                header(i, taken, ""), HEIGHT, WIDTH, "mono16", 0, 2 * WIDTH, pixels
            )
            bag.write(images, i * 33_333_333, STORE.serialize_ros1(message, kind))
    return path


ROS2 = get_typestore(Stores.ROS2_HUMBLE)
SQL = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
    offered_qos_profiles TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
    data BLOB NOT NULL);
"""


def write_database(
    path: Path, frames: int = 2, depth_mm: int = 600, *, unit_m: float = 0.001, packed: bool = False
) -> Path:
    """The same as the SDK writes it since 2026:
    rosbag2 in SQLite, with texts for what does not move.

    A colour stream comes first. `packed`: each message is compressed by itself.
    """
    types = ROS2.types
    rows: list[tuple[str, int, Any]] = [
        ("/file_version", 0, types["std_msgs/msg/UInt32"](4)),
        ("/device_0/sensor_0/option/Depth_Units/value", 0,
            types["std_msgs/msg/String"](f"{unit_m:f}")),
        (f"{STREAM}/info", 0, types["std_msgs/msg/String"]("encoding=Z16;fps=30")),
        (f"{STREAM}/camera_info", 0, types["std_msgs/msg/String"](
            f"width={WIDTH};height={HEIGHT};fx={FOCAL_PX};ppx={WIDTH / 2 - 0.5};fy={FOCAL_PX};ppy={HEIGHT / 2 - 0.5};"
            "model=Brown Conrady;coeffs=0,0,0,0,0")),
    ]  # fmt: skip
    for i in range(frames):
        time_ns = 1_770_000_000 * 10**9 + i * 33_333_333
        stamp = types["builtin_interfaces/msg/Time"](*divmod(time_ns, 10**9))
        counts = round(1e-3 * depth_mm / unit_m)
        for stream, encoding, pixels in (
            ("/device_0/sensor_1/Color_0", "rgb8", np.zeros(3 * WIDTH * HEIGHT, np.uint8)),
            (STREAM, "mono16", np.full(WIDTH * HEIGHT, counts, "<u2").view(np.uint8)),
        ):
            head = types["std_msgs/msg/Header"](stamp, "Depth")
            step = len(pixels) // HEIGHT
            image = types["sensor_msgs/msg/Image"](head, HEIGHT, WIDTH, encoding, 0, step, pixels)
            rows.append((f"{stream}/image/data", time_ns, image))
    path.unlink(missing_ok=True)
    with sqlite3.connect(path) as file:
        file.executescript(SQL)
        numbers = {
            topic: number
            for number, topic in enumerate(dict.fromkeys(topic for topic, _, _ in rows), start=1)
        }
        kinds = {topic: message.__msgtype__ for topic, _, message in rows}
        file.executemany(
            "INSERT INTO topics VALUES(?, ?, ?, 'cdr', '')",
            [(n, t, kinds[t]) for t, n in numbers.items()],
        )
        for topic, time_ns, message in rows:
            data = bytes(ROS2.serialize_cdr(message, kinds[topic]))
            data = zstandard.ZstdCompressor(level=1).compress(data) if packed else data
            file.execute(
                "INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)",
                (numbers[topic], time_ns, data),
            )
    file.close()
    return path
