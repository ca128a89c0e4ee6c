"""A course of one's own: it is crossed, and a viewer of the recording sees images that lie on it.

The viewer is plain readers of MCAP and ROS 2 alone.
"""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plain_reader import messages_of

from saltus.cli.main import main
from saltus.config import load_config
from saltus.recordings.recording import read_recording
from saltus.recordings.summary import summarise_run
from saltus.terrain.terrain import Terrain

EXAMPLE = Path(__file__).parents[2] / "examples" / "course.toml"
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


@pytest.fixture(scope="module")
def crossed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of a run over the course, whose file is gone by now."""
    folder = tmp_path_factory.mktemp("run")
    course = folder / "course.toml"
    shutil.copy(EXAMPLE, course)
    assert (
        main(
            [
                "demo",
                "--terrain",
                str(course),
                "--camera",
                "ideal",
                "--no-video",
                "--out",
                str(folder),
            ]
        )
        == 0
    )
    course.unlink()
    return folder / "recording.mcap"


@pytest.mark.slow
def test_a_course_is_crossed_from_its_file_alone_and_the_recording_has_it(crossed: Path) -> None:
    recording = read_recording(crossed)
    assert recording.terrain == load_config(Terrain, EXAMPLE)
    assert summarise_run(recording).terrain == recording.terrain.kind
    heights = recording.terrain.height_at(np.array([1.0, 2.0, 3.0, 4.2, 6.2465, 8.0]), 0.0)
    np.testing.assert_allclose(heights, [0.0, 0.2, 0.4, 0.1, 0.6, 0.8], atol=1e-3)


@pytest.mark.slow
def test_depth_images_lie_on_the_terrain(crossed: Path) -> None:
    read: dict[str, list[Any]] = {}
    for topic, _, message, _ in messages_of(crossed):
        read.setdefault(topic, []).append(message)
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
        points = np.stack(
            [(u - info.k[2]) / info.k[0] * z, (v - info.k[5]) / info.k[4] * z, z], axis=-1
        )
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
        outside, inside = (
            np.linalg.norm(np.maximum(beyond, 0.0), axis=1),
            np.minimum(beyond.max(axis=1), 0.0),
        )
        nearest = np.minimum(nearest, np.abs(outside + inside))
    return nearest
