import os
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from random_terrain import random_terrain
from samples import ROBOT

from saltus.config import TerrainConfig
from saltus.errors import SaltusError
from saltus.grid import HEIGHTMAP_X, LINE, HeightGrid
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.sim.plant import standing_pose
from saltus.sim.video import heightmap_in_world, render_run, write_video
from saltus.sim.video import test_frame as draw_test_frame
from saltus.terrain.curriculum import FAMILIES, make_terrain

SIZE = (320, 240)


def frames(
    kind: str, count: int = 2, *, heightmap: bool = True, x: float = 1.0, yaw: float = 0.0
) -> np.ndarray:
    """Pictures of a robot that stands and turns by `yaw`."""
    terrain = make_terrain(TerrainConfig(terrain=kind))
    time_s = np.arange(0.0, count / 30.0 - 1e-6, 0.01)
    turn = quaternion_from_roll_pitch_yaw(np.zeros(()), np.zeros(()), np.asarray(yaw))
    pose = np.tile(np.concatenate([[x, 0.0, 0.285], turn]), (len(time_s), 1))
    height = np.tile(terrain.height_at(x + HEIGHTMAP_X, 0.0) - 0.285, (len(time_s), 1))
    joints = np.tile(ROBOT.stand_pose, (len(time_s), 1))
    shown = height if heightmap else np.full_like(height, np.nan)
    return np.stack(list(render_run(ROBOT, terrain, time_s, pose, joints, LINE, shown, size=SIZE)))


def pink(pictures: np.ndarray) -> int:
    """Pixels in the colour of the heightmap."""
    red, green, blue = (pictures[..., i].astype(int) for i in range(3))
    return int(((red - green > 80) & (blue - green > 40)).sum())


@pytest.mark.sample(2)
@pytest.mark.parametrize("kind", FAMILIES)
def test_frames_show_robot_ground_and_heightmap(kind: str) -> None:
    pictures = frames(kind)
    assert pictures.shape == (2, SIZE[1], SIZE[0], 3)
    assert pictures.dtype == np.uint8
    assert pictures.std() > 20.0
    assert pink(pictures) > 50
    assert pink(frames(kind, heightmap=False)) == 0
    top, bottom = pictures[:, 0].mean(axis=(0, 1)), pictures[:, -1].mean(axis=(0, 1))
    assert top[2] > top[0] + 30.0  # sky above, ground below
    assert abs(bottom[2] - bottom[0]) < 40.0


def test_turned_boxes_and_a_wide_heightmap_can_be_drawn() -> None:
    terrain = random_terrain(3)
    grid = HeightGrid(x=tuple(np.linspace(-0.4, 0.8, 12)), y=(-0.3, 0.0, 0.3))
    pose = standing_pose(ROBOT, terrain, np.asarray(1.0), np.asarray(0.4))[None]
    height = terrain.height_at(*grid.points_in_world(pose[0, :2], np.asarray(0.4))) - pose[0, 2]
    shown, without = (
        next(
            render_run(
                ROBOT,
                terrain,
                np.zeros(1),
                pose[:, :7],
                pose[:, 7:],
                grid,
                heights[None],
                size=SIZE,
            )
        )
        for heights in (height, np.full_like(height, np.nan))
    )
    assert pink(shown[None]) > pink(frames("flat", count=1))
    assert pink(without[None]) == 0


def test_frames_repeat_and_follow_the_robot() -> None:
    first = frames("stairs")
    np.testing.assert_array_equal(first, frames("stairs"))
    assert np.abs(first.astype(int) - frames("stairs", x=1.3).astype(int)).mean() > 1.0


@pytest.mark.parametrize("yaw", [0.5, -1.6])
def test_any_heading_can_be_drawn(yaw: float) -> None:
    assert pink(frames("stairs", count=1, yaw=yaw)) > 0


def test_the_environment_stays_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    for value in (None, "egl"):
        if value is None:
            monkeypatch.delenv("MUJOCO_GL", raising=False)
        else:
            monkeypatch.setenv("MUJOCO_GL", value)
        frames("flat", count=1)
        assert os.environ.get("MUJOCO_GL") == value


def test_a_heightmap_lies_on_the_terrain_along_the_yaw() -> None:
    yaw = 0.7
    turn = quaternion_from_roll_pitch_yaw(np.asarray(0.2), np.asarray(-0.3), np.asarray(yaw))
    points = heightmap_in_world(np.concatenate([[1.0, 2.0, 0.3], turn]), LINE, np.full(30, -0.3))
    np.testing.assert_allclose(points[:, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(points[:, 0], 1.0 + np.cos(yaw) * HEIGHTMAP_X)
    np.testing.assert_allclose(points[:, 1], 2.0 + np.sin(yaw) * HEIGHTMAP_X)


def test_the_file_holds_every_frame(tmp_path: Path) -> None:
    path = tmp_path / "run.mp4"
    assert write_video(path, iter(frames("gap", count=7)), size=SIZE) == 7
    count, duration_s = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert count == 7
    assert duration_s == pytest.approx(7 / 30, abs=0.01)
    content = path.read_bytes()
    assert b"avc1" in content  # H.264
    # A browser can start before it has the whole file
    assert content.index(b"moov") < content.index(b"mdat")


def test_a_run_without_samples_has_no_video() -> None:
    terrain = make_terrain(TerrainConfig())
    none = np.zeros((0, 1))
    with pytest.raises(SaltusError, match="at least one sample"):
        next(render_run(ROBOT, terrain, np.zeros(0), none, none, LINE, none))


def test_the_test_picture_shows_what_it_should() -> None:
    picture = draw_test_frame(ROBOT, LINE)
    assert picture.shape == (480, 640, 3)
    assert pink(picture) > 200
