"""Images of a stereo camera: those that data are made of, and those that robots in roll-outs get."""

from dataclasses import replace

import numpy as np
import pytest
from samples import ROBOT, setups_of
from synthetic_motion import gliding_robots

from saltus.config import TerrainConfig
from saltus.depth import MILLIMETRE, MODEL_CAMERA, RANGE_M
from saltus.depth_camera import SHIPPED
from saltus.effects.profile import Profile
from saltus.grid import LINE
from saltus.heightmap.data.closed_loop import closed_loop_episodes
from saltus.heightmap.data.mounts import random_mount
from saltus.heightmap.data.robot_cameras import IdealCameras, StereoCameras
from saltus.heightmap.data.rollouts import Trajectory, true_images
from saltus.heightmap.data.stereo_images import SAMPLED, stereo_images
from saltus.heightmap.settings import ClosedLoop
from saltus.policy.evaluation.rollout import STAND_STEPS, Rollout
from saltus.policy.planner import make_planner
from saltus.render.camera import RobotCamera
from saltus.render.randomisation import drawn_cameras
from saltus.render.stereo.camera import IDEAL_STEREO, StereoConfig
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.stack import TerrainStack
from saltus.trial import Trial

D435I = SHIPPED["d435i"]


@pytest.fixture(scope="module")
def motion() -> list[Trajectory]:
    rng = np.random.default_rng(0)
    short = gliding_robots(rng, 3, ticks=41, terrains=("stairs", "gap"))
    return [*short, *gliding_robots(rng, 3, ticks=60, terrains=("stepping_stones", "step"))]


def test_images_are_true_depth_with_the_errors_of_a_camera(motion: list[Trajectory]) -> None:
    rng = np.random.default_rng(1)
    views = [replace(RobotCamera.on(ROBOT, SAMPLED), mount=random_mount(ROBOT, rng)) for _ in motion]
    images, again = (stereo_images(motion, views, D435I, np.random.default_rng(2)) for _ in range(2))
    off_mm = []
    for trajectory, view, image, same in zip(motion, views, images, again, strict=True):
        true = true_images(trajectory, replace(view, intrinsics=MODEL_CAMERA), D435I)
        assert image.shape == true.shape == (-(-len(trajectory.joint_position) // 2), 48, 16)  # 50 Hz
        np.testing.assert_array_equal(image, same)
        assert (image == 0).mean() < 0.1
        near = (true < 1.0) & (image > 0.0)
        off_mm.append(1e3 * np.abs(image - true)[near])
    assert 0.3 < np.median(np.concatenate(off_mm)) < 10.0  # D435i: 1.9 mm a pixel at 0.5 m, 7.6 mm at 1 m


def test_cameras_differ_in_how_bad_they_are() -> None:
    sigma = np.asarray(drawn_cameras(200, np.random.default_rng(0), StereoConfig()).disparity_noise.sigma)
    assert sigma.shape == (200,)
    assert 0.03 < sigma.min() < 0.04 < 0.15 < sigma.max() < 0.16  # 0.4 to 2 times 0.08 px


def test_images_do_not_depend_on_the_renderer(motion: list[Trajectory]) -> None:
    """To the millimetre, with the same errors, in nearly all pixels: at edges a rasteriser may see the other side."""
    views = [RobotCamera.on(ROBOT, SAMPLED) for _ in motion]
    for take in (
        lambda renderer: stereo_images(motion, views, D435I, np.random.default_rng(2), renderer),
        lambda renderer: [true_images(trajectory, RobotCamera.on(ROBOT), D435I, renderer) for trajectory in motion],
    ):
        rays, drawn = (np.minimum(np.concatenate(take(renderer)), RANGE_M) for renderer in ("embree", "pyrender"))
        assert (rays != drawn).any()
        assert (np.abs(rays - drawn) <= 1.001 * MILLIMETRE).mean() > 0.99
        assert ((rays == 0) == (drawn == 0)).mean() > 0.999


def test_motion_does_not_depend_on_camera_and_renderer() -> None:
    seen_by = [("ideal", "embree"), ("d435i", "embree"), ("d435i", "pyrender")]
    loop = ClosedLoop(robot="go1", grid="line", robots=2, courses=2, ticks=STAND_STEPS)
    true, rays, drawn = (
        closed_loop_episodes(replace(loop, camera=camera, renderer=renderer), None, (5, 0, 0))
        for camera, renderer in seen_by
    )
    assert len(true) == len(rays) == len(drawn) > 0
    for other in (rays, drawn):
        for a, b in zip(true, other, strict=True):
            np.testing.assert_array_equal(a.height, b.height)
            np.testing.assert_array_equal(a.proprioception, b.proprioception)
            assert (a.depth != b.depth).any()


def test_a_stereo_camera_without_errors_takes_true_images() -> None:
    kinds = ("stairs", "gap")
    courses = [make_terrain(TerrainConfig(terrain=kind, difficulty=0.2)) for kind in kinds]
    terrains = [courses[0], courses[1], courses[0]]
    rollout = Rollout(
        setups_of(terrains, [Trial.draw(seed) for seed in range(3)]), make_planner("scripted", ROBOT, LINE)
    )
    stack = TerrainStack(terrains)
    ideal = IdealCameras(SHIPPED["ideal"], ROBOT, stack, Profile())
    stereo = StereoCameras(D435I, ROBOT, stack, Profile(), IDEAL_STEREO, np.random.default_rng(0).spawn(3))
    for _ in range(3):
        step = rollout.step()
        true, seen = (cameras.expose(step.truth, step.states.time_s) for cameras in (ideal, stereo))
        inside = np.isfinite(true) & np.isfinite(seen) & (true < RANGE_M)
        # A pixel of the one is the mean of three rays of the other: alike but at edges.
        assert inside.mean() > 0.3
        assert np.median(np.abs(true[inside] - seen[inside])) < 2.0 * MILLIMETRE
