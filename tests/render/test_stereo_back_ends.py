"""What the right imager does not see, by every back end:
by rays from it, or by an image from it.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from samples import ROBOT
from stereo_scenes import poses, wall_and_panel

from saltus.config import TerrainConfig
from saltus.depth import D435I, MODEL_CAMERA, Intrinsics, supersampled_model_camera
from saltus.render.backends import make_renderer, make_stereo
from saltus.render.camera import RobotCamera
from saltus.render.stereo.image import ARRAY_WINDOWS
from saltus.render.stereo.optics import StereoOptics
from saltus.render.stereo_pyrender import NEAREST_M
from saltus.robots.mount import Mount
from saltus.terrain.boxes import Box
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain

BACK_ENDS = ("embree", "pyrender", "warp")
FAST, NATIVE = supersampled_model_camera(3, 1), supersampled_model_camera(5, 5)
HALF = replace(D435I, width=212, height=120, fx=105.66, fy=105.66, cx=106.7, cy=60.0)


def wall_behind_panel(
    wall_m: float, panel_m: float, left: float, right: float
) -> tuple[Terrain, RobotCamera, Any]:
    """Both upright before a camera that looks ahead, the panel between two tangents of its view.

    Camera and pose.
    """
    panel = Box.at(
        (panel_m, -0.5 * (left + right) * panel_m, 0.0), (1e-5, (right - left) * panel_m, 9.0)
    )
    terrain = Terrain(
        kind="panel",
        boxes=(Box.at((wall_m + 0.5, 0.0, 0.0), (1.0, 90.0, 90.0)), panel),
        finish_x=1.0,
    )
    mount = Mount(position=ROBOT.camera_position, pitch=0.0)
    pose = -mount.position, np.array([1.0, 0.0, 0.0, 0.0]), ROBOT.stand_pose
    return terrain, RobotCamera(robot=ROBOT, intrinsics=HALF, mount=mount, legs=False), pose


@pytest.mark.parametrize("name", BACK_ENDS)
@pytest.mark.parametrize("seed", range(6))
def test_a_panels_shadow_lies_to_its_left_and_is_as_wide_as_baseline_and_depths_make_it(
    name: str, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    panel_m, left, width = rng.uniform(0.3, 0.8), rng.uniform(-0.2, 0.4), rng.uniform(0.15, 0.4)
    wall_m, baseline_m = panel_m + rng.uniform(0.2, 3.0), rng.uniform(0.03, 0.08)
    optics = StereoOptics.of(HALF, sensor=HALF, baseline_m=baseline_m)
    terrain, camera, pose = wall_behind_panel(wall_m, panel_m, left, left + width)
    depth, hidden = make_stereo(name, terrain, optics, camera).render_pair(*pose)
    true_depth, true_hidden = wall_and_panel(HALF, optics, wall_m, panel_m, left, left + width)
    # But for the column of the panel's edge
    assert np.mean(np.isclose(depth, true_depth, atol=1e-3)) > 0.99
    wide_px = HALF.fx * baseline_m * (1.0 / panel_m - 1.0 / wall_m)
    np.testing.assert_allclose(hidden.sum(-1), min(wide_px, width * HALF.fx), atol=1.0)
    edge_px = HALF.cx + left * HALF.fx
    assert np.all(np.flatnonzero(hidden.any(0)) < edge_px)
    assert np.mean(hidden != true_hidden) <= 2.0 / HALF.width  # a column at either border


@pytest.mark.sample(4)
@pytest.mark.parametrize("name", ["pyrender", "warp"])
@pytest.mark.parametrize("camera", [FAST, NATIVE], ids=["fast chain", "native chain"])
@pytest.mark.parametrize("kind", ["stairs", "step", "irregular"])
def test_every_back_end_finds_the_shadows_that_rays_find(
    name: str, camera: Intrinsics, kind: str
) -> None:
    ground, optics = make_terrain(TerrainConfig(terrain=kind)), StereoOptics.of(camera)
    eye, where = RobotCamera.on(ROBOT, camera), poses(ground, 24, seed=3)
    (true, by_rays), (depth, hidden) = (
        make_stereo(each, ground, optics, eye).render_pair_batch(*where)
        for each in ("embree", name)
    )
    np.testing.assert_array_equal(depth, make_renderer(name, ground, eye).render_batch(*where))
    alike = np.isclose(depth, true, atol=1e-3) & (true > NEAREST_M)
    border = ARRAY_WINDOWS.any_around(by_rays, 1, 1) & ARRAY_WINDOWS.any_around(~by_rays, 1, 1)
    assert by_rays.mean() > 0.005
    assert np.mean((hidden != by_rays)[alike]) < 0.002
    assert np.mean((hidden != by_rays)[alike & ~border]) < 4e-4


def test_auto_takes_rays_for_pairs_of_any_size() -> None:
    for camera in (MODEL_CAMERA, D435I):
        pair = make_stereo(
            "auto",
            make_terrain(TerrainConfig()),
            StereoOptics.of(camera),
            RobotCamera.on(ROBOT, camera),
        )
        assert pair.name == "embree"
