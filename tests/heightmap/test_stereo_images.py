"""Images of a stereo camera: those that data are made of,
and those that robots in roll-outs get.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from samples import ROBOT, setups_of
from synthetic_motion import gliding_robots

from saltus.config import TerrainConfig
from saltus.depth import MILLIMETRE, MODEL_CAMERA, NOTHING, depth_frame, depth_in_millimetres
from saltus.depth_camera import SHIPPED, DepthCamera, load_camera
from saltus.effects.profile import Profile
from saltus.grid import LINE
from saltus.heightmap.data.closed_loop import closed_loop_episodes
from saltus.heightmap.data.randomisation import random_mount
from saltus.heightmap.data.robot_cameras import rendered_intrinsics, robot_cameras
from saltus.heightmap.data.rollouts import RobotTrajectory, film_robots
from saltus.heightmap.data.scan_heights import ScanHeights
from saltus.heightmap.scan.predictor import ScanNetwork
from saltus.heightmap.scan.scan_camera import ScanCamera, read_lens
from saltus.heightmap.settings import ClosedLoop
from saltus.loop.loop import STAND_STEPS, Loop
from saltus.policy.planner import make_planner
from saltus.render.camera import RobotCamera
from saltus.render.embree import EmbreeRenderer
from saltus.render.eyes import SAMPLED
from saltus.render.randomisation import drawn_cameras
from saltus.render.stereo.camera import IDEAL_STEREO, StereoConfig
from saltus.render.stereo.model_view import COLUMNS, ROWS, pool_valid
from saltus.robots.mount import Mount
from saltus.setup import Setup
from saltus.terrain.curriculum import make_terrain
from saltus.trial import Trial
from saltus.used_networks import model_path

D435I, WHOLE = SHIPPED["d435i"], SHIPPED["d435i_whole"]
IDEAL, IDEAL_WHOLE = SHIPPED["ideal"], replace(WHOLE, ideal=True)
OWN = load_camera(str(Path(__file__).parents[2] / "examples" / "camera.toml"))
STAIRS = make_terrain(TerrainConfig(terrain="stairs", difficulty=0.2))


@pytest.fixture(scope="module")
def motion() -> list[RobotTrajectory]:
    rng = np.random.default_rng(0)
    short = gliding_robots(rng, 3, ticks=41, terrains=("stairs", "gap"))
    return [*short, *gliding_robots(rng, 3, ticks=60, terrains=("stepping_stones", "step"))]


def taken(
    motion: list[RobotTrajectory],
    views: list[RobotCamera],
    camera: DepthCamera,
    renderer: str = "embree",
) -> list[NDArray[np.uint16]]:
    """Images of each robot [mm]."""
    rng = np.random.default_rng(2)
    return [
        episode.depth
        for episode in film_robots(motion, views, camera, Profile(), LINE, rng, renderer)
    ]


def test_images_are_true_depth_with_the_errors_of_a_camera(motion: list[RobotTrajectory]) -> None:
    rng = np.random.default_rng(1)
    views = [
        replace(RobotCamera.on(ROBOT, SAMPLED), mount=random_mount(ROBOT, rng)) for _ in motion
    ]
    images, again = (taken(motion, views, D435I) for _ in range(2))
    exact = [replace(view, intrinsics=MODEL_CAMERA) for view in views]
    truth, off_mm = taken(motion, exact, replace(D435I, ideal=True)), []
    for trajectory, image, same, true in zip(motion, images, again, truth, strict=True):
        # 50 Hz
        assert image.shape == true.shape == (-(-len(trajectory.joint_position) // 2), 48, 16)
        np.testing.assert_array_equal(image, same)
        assert (image == 0).mean() < 0.1
        near = (true < 1000) & (image > 0)
        off_mm.append(np.abs(image.astype(int) - true)[near])
    # D435i: 1.9 mm a pixel at 0.5 m, 7.6 mm at 1 m
    assert 0.3 < np.median(np.concatenate(off_mm)) < 10.0


def test_cameras_differ_in_how_bad_they_are() -> None:
    sigma = np.asarray(
        drawn_cameras(200, np.random.default_rng(0), StereoConfig()).disparity_noise.sigma
    )
    assert sigma.shape == (200,)
    assert 0.03 < sigma.min() < 0.04 < 0.15 < sigma.max() < 0.16  # 0.4 to 2 times 0.08 px


def test_images_do_not_depend_on_the_renderer(motion: list[RobotTrajectory]) -> None:
    """To the millimetre, with the same errors, in nearly all pixels:
    at edges a rasteriser may see the other side.
    """
    for camera, intrinsics in ((D435I, SAMPLED), (replace(D435I, ideal=True), MODEL_CAMERA)):
        views = [RobotCamera.on(ROBOT, intrinsics) for _ in motion]
        rays, drawn = (
            np.minimum(np.concatenate(taken(motion, views, camera, renderer)), 3000).astype(int)
            for renderer in ("embree", "pyrender")
        )
        assert (rays != drawn).any()
        assert (np.abs(rays - drawn) <= 1).mean() > 0.99
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
    setups = setups_of(terrains, [Trial.draw(seed) for seed in range(3)])
    rollout = Loop(setups, make_planner("scripted", ROBOT, LINE))
    ideal, stereo = (
        robot_cameras(
            [replace(each, camera=camera, profile=Profile()) for each in setups], IDEAL_STEREO
        )[0]
        for camera in (SHIPPED["ideal"], D435I)
    )
    for i in range(5):
        step = rollout.step()
        true, seen = (eyes.expose(step.truth, i, step.fresh) for eyes in (ideal, stereo))
        assert (true is None) == (seen is None) == (i % 2 == 1)
        if true is None or seen is None:
            continue
        assert true.depth.dtype == seen.depth.dtype == np.uint16
        inside = (true.depth < 3000) & (seen.depth < NOTHING)
        # A pixel of the one is the mean of three rays of the other: alike but at edges.
        assert inside.mean() > 0.3
        assert np.median(np.abs(true.depth.astype(int) - seen.depth)[inside]) < 2.0


def on_stairs(camera: DepthCamera) -> list[Setup]:
    """Three robots whose camera sits where it says."""
    drawn = setups_of([STAIRS] * 3, [Trial.draw(seed) for seed in range(3)])
    return [
        replace(each, camera=camera, robot=camera.mounted_on(each.robot), profile=Profile())
        for each in drawn
    ]


def test_whole_images_have_the_pixels_of_which_the_model_gets_means() -> None:
    setups = on_stairs(D435I)
    rollout = Loop(setups, make_planner("scripted", ROBOT, LINE))
    pairs = [robot_cameras(setups, whole=whole)[0] for whole in (False, True)]
    for i in range(3):
        step = rollout.step()
        means, whole = (eyes.expose(step.truth, i, step.fresh) for eyes in pairs)
        if means is None or whole is None:
            assert i % 2 == 1
            continue
        lens = rendered_intrinsics(D435I, whole=True)
        assert lens == SAMPLED
        assert whole.depth.shape == (3, lens.height, lens.width)
        expected = pool_valid(whole.depth * MILLIMETRE, ROWS, COLUMNS) / MILLIMETRE
        np.testing.assert_allclose(means.depth, expected, atol=1.0)  # both in whole millimetres


@pytest.mark.parametrize("camera", [WHOLE, OWN, replace(OWN, ideal=True)])
def test_whole_images_of_a_wide_camera_are_those_of_its_own_pixels_that_the_scan_reads(
    camera: DepthCamera,
) -> None:
    setups = on_stairs(camera)
    step = Loop(setups, make_planner("scripted", ROBOT, LINE)).step()
    given = robot_cameras(setups, IDEAL_STEREO, whole=True)[0].expose(step.truth, 0, step.fresh)
    assert given is not None
    truth, view = step.truth, RobotCamera.on(setups[0].robot, camera.image)
    sent = depth_in_millimetres(
        EmbreeRenderer(STAIRS, view).render_batch(
            truth.position_base_in_world, truth.quaternion_base_in_world, truth.joint_position
        )
    )
    lens, scan = read_lens(camera.image), ScanCamera(Mount.of(setups[0].robot))
    for image, own in zip(given.depth, sent, strict=True):
        seen, run = (
            scan.points(depth_frame(of, depth), np.array([0.0, 0.0, 1.0]), 0.3)
            for of, depth in ((lens, image), (camera.image, own))
        )
        np.testing.assert_allclose(seen.depth, run.depth, atol=2e-3)
        np.testing.assert_allclose(seen.points, run.points, atol=1e-2)
        assert np.ptp(seen.points[:, 1]) > 1.0  # the model's image of this ground is 0.5 m wide


def test_pixels_that_are_read_look_where_those_of_the_image_do() -> None:
    up = np.array([0.0, 0.0, 1.0])
    for lens in (WHOLE.image, D435I.image, OWN.image):
        own = read_lens(lens)
        read, whole = (
            ScanCamera(Mount.of(ROBOT)).points(
                depth_frame(of, np.full((of.height, of.width), 1000, np.uint16)), up, 0.3
            )
            for of in (own, lens)
        )
        np.testing.assert_allclose(read.points, whole.points, atol=1e-6)
        assert len(read.points) == own.width * own.height
        assert (own == lens) == (lens == WHOLE.image)


def test_images_of_cameras_that_see_no_more_than_the_model_are_as_they_were() -> None:
    narrow = replace(D435I, image=replace(D435I.image, height=120, cy=60.0))
    for camera, lens in (
        (D435I, SAMPLED),
        (narrow, SAMPLED),
        (SHIPPED["ideal"], MODEL_CAMERA),
    ):
        assert rendered_intrinsics(camera, whole=True) == rendered_intrinsics(camera) == lens
    assert rendered_intrinsics(WHOLE, whole=True) == WHOLE.image
    assert rendered_intrinsics(WHOLE) == SAMPLED


def test_the_range_of_a_wide_camera_masks_its_whole_image() -> None:
    short = replace(WHOLE, range_m=(0.3, 0.6))
    setups = on_stairs(WHOLE)
    step = Loop(setups, make_planner("scripted", ROBOT, LINE)).step()
    everything, near = (
        robot_cameras([replace(each, camera=camera) for each in setups], IDEAL_STEREO, whole=True)[
            0
        ].expose(step.truth, 0, step.fresh)
        for camera in (WHOLE, short)
    )
    assert everything is not None
    assert near is not None
    inside = (everything.depth >= 300) & (everything.depth <= 600)
    np.testing.assert_array_equal(near.depth, np.where(inside, everything.depth, 0))
    assert inside[..., :10].any()  # beside what the model sees


def test_the_model_is_given_the_middle_of_the_images_of_a_wide_camera() -> None:
    network = ScanNetwork(model_path("scan"))
    sources = [ScanHeights(network, on_stairs(camera)) for camera in (IDEAL, IDEAL_WHOLE)]
    for source in sources:
        Loop(on_stairs(IDEAL), make_planner("scripted", ROBOT, LINE), heights=source).step()
    narrow, wide = (source.given for source in sources)
    assert narrow is not None
    assert wide is not None
    assert wide.depth.shape == narrow.depth.shape == (3, 48, 16)
    off_mm = np.abs(np.minimum(narrow.depth, 3000).astype(int) - wide.depth)
    assert np.median(off_mm) < 3
