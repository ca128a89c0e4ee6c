"""What a viewer shows of a recording: with plain readers of MCAP and ROS 2 alone, images lie on the terrain."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from saltus.cli.main import main

STORE = get_typestore(Stores.ROS2_JAZZY)
CLOSE_M = 0.005
LEGS_REACH_M = 0.6  # from the camera: nearer may be the robot itself


def rotation(q: Any) -> np.ndarray:
    x, y, z, w = q.x, q.y, q.z, q.w
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def pose_of(transform: Any) -> tuple[np.ndarray, np.ndarray]:
    t = transform.transform.translation
    return np.array([t.x, t.y, t.z]), rotation(transform.transform.rotation)


@pytest.mark.parametrize("course", ["stairs", "examples/course.toml"])
def test_depth_images_lie_on_the_terrain(course: str, tmp_path: Path) -> None:
    place = str(Path(__file__).parents[2] / course) if "/" in course else course
    flags = ["--camera", "ideal", "--time-limit-s", "2.5", "--no-video", "--out", str(tmp_path)]
    main(["demo", "--terrain", place, *flags])
    read: dict[str, list[Any]] = {}
    with (tmp_path / "recording.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if schema is not None and channel.topic.startswith("/viewer/"):
                read.setdefault(channel.topic, []).append(STORE.deserialize_cdr(message.data, schema.name))
    (terrain,) = read["/viewer/terrain"]
    poses: dict[tuple[int, str], Any] = {}
    for message in read["/viewer/tf"]:
        for transform in message.transforms:
            stamp = transform.header.stamp
            poses[10**9 * stamp.sec + stamp.nanosec, transform.child_frame_id] = pose_of(transform)
    off = []
    for image, info in zip(read["/viewer/depth"], read["/viewer/camera_info"], strict=True):
        time_ns = 10**9 * image.header.stamp.sec + image.header.stamp.nanosec
        (base, base_turn), (camera, camera_turn) = poses[time_ns, "base"], poses[time_ns, "camera"]
        depth = image.data.view(np.uint16).reshape(image.height, image.width)
        v, u = np.nonzero((depth > 1e3 * LEGS_REACH_M) & (depth < 65535))
        z = 1e-3 * depth[v, u]
        points = np.stack([(u - info.k[2]) / info.k[0] * z, (v - info.k[5]) / info.k[4] * z, z], axis=-1)
        world = (points @ camera_turn.T + camera) @ base_turn.T + base
        off.append(distance_to_boxes(world, terrain.markers))
    distances = np.concatenate(off)
    assert len(distances) > 1000
    assert distances.max() < CLOSE_M


def distance_to_boxes(points: np.ndarray, markers: list[Any]) -> np.ndarray:
    """Of each point to the nearest surface of a box [m]."""
    nearest = np.full(len(points), np.inf)
    for marker in markers:
        center, size = (np.array([v.x, v.y, v.z]) for v in (marker.pose.position, marker.scale))
        beyond = np.abs((points - center) @ rotation(marker.pose.orientation)) - 0.5 * size
        outside, inside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1), np.minimum(beyond.max(axis=1), 0.0)
        nearest = np.minimum(nearest, np.abs(outside + inside))
    return nearest
