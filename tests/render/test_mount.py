"""A camera's mount is a full pose, for every consumer the same."""

from dataclasses import replace

import numpy as np
import pytest
from samples import ROBOT

from saltus.config import TerrainConfig
from saltus.depth import MODEL_CAMERA
from saltus.depth_camera import SHIPPED, DepthCamera
from saltus.recordings import ros_messages as ros
from saltus.render.backends import make_renderer
from saltus.render.camera import RobotCamera, camera_pose, ray_directions
from saltus.robots.mount import Mount
from saltus.robots.robot import Robot
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix
from saltus.terrain.curriculum import make_terrain

LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Camera frame to base frame of a camera that looks level ahead."""


def drawn(seed: int) -> tuple[Mount, DepthCamera, Robot]:
    """A pose on the trunk, and camera and robot that have it."""
    rng = np.random.default_rng(seed)
    roll, pitch, yaw = rng.uniform((-0.6, 0.3, -0.6), (0.6, 0.9, 0.6)).tolist()
    position = (0.3, *rng.uniform(-0.05, 0.05, 1).tolist(), 0.12)
    camera = replace(
        SHIPPED["ideal"],
        name="mine",
        camera_position=position,
        camera_roll=roll,
        camera_pitch=pitch,
        camera_yaw=yaw,
    )
    return (
        Mount(position=np.array(position), roll=roll, pitch=pitch, yaw=yaw),
        camera,
        camera.mounted_on(ROBOT),
    )


@pytest.mark.parametrize("seed", range(5))
def test_a_pose_is_the_same_in_files_viewers_and_renderers(seed: int) -> None:
    mount, camera, robot = drawn(seed)
    angles = (np.array(angle) for angle in (mount.roll, mount.pitch, mount.yaw))
    rotation = rotation_matrix(quaternion_from_roll_pitch_yaw(*angles)) @ LEVEL
    np.testing.assert_allclose(mount.rotation, rotation, atol=1e-12)
    np.testing.assert_array_equal(Mount.of(robot).rotation, mount.rotation)
    assert DepthCamera.from_toml(camera.to_toml()) == camera
    np.testing.assert_array_equal(
        Mount.of(Robot.from_toml(robot.to_toml())).rotation, mount.rotation
    )
    shown = ros.optical(robot.camera_roll, robot.camera_pitch, robot.camera_yaw)
    np.testing.assert_allclose(rotation_matrix(np.array(shown)), rotation, atol=1e-12)


@pytest.mark.parametrize("back_end", ["embree", "pyrender"])
@pytest.mark.parametrize("seed", range(3))
def test_level_ground_is_level_from_every_pose(seed: int, back_end: str) -> None:
    """Deprojected by its pose, what a camera sees of flat ground lies on the ground."""
    _, _, robot = drawn(seed)
    view = RobotCamera.on(robot, legs=False)
    pose = np.array([0.0, 0.0, 0.32]), quaternion_from_roll_pitch_yaw(*np.array([0.05, -0.1, 0.3]))
    depth = make_renderer(back_end, make_terrain(TerrainConfig(terrain="flat")), view).render(
        *pose, robot.stand_pose
    )  # fmt: skip
    origin, rotation = camera_pose(view.mount, *pose)
    seen = np.isfinite(depth) & (depth > 0.0)
    points = origin + (ray_directions(MODEL_CAMERA) * depth[..., None])[seen] @ rotation.T
    assert seen.mean() > 0.3
    np.testing.assert_allclose(points[:, 2], 0.0, atol=2e-3)


@pytest.mark.parametrize("pitch", [-1.2, 0.0, 0.52, 1.5])
def test_without_roll_and_yaw_rotations_are_to_the_bit_what_they_were(pitch: float) -> None:
    c, s = np.cos(pitch), np.sin(pitch)
    axes = [(0.0, -1.0, 0.0), (-s, 0.0, -c), (c, 0.0, -s)]
    np.testing.assert_array_equal(
        Mount(position=np.zeros(3), pitch=pitch).rotation, np.stack(axes, -1)
    )
