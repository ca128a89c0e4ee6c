"""The stereo camera on rendered terrain: the fast chain against the native one."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from samples import ROBOT
from stereo_scenes import flat_wall, wall_and_panel

from saltus.config import TerrainConfig
from saltus.depth import (
    MODEL_CAMERA,
    Intrinsics,
    depth_in_millimetres,
    model_image,
    supersampled_model_camera,
)
from saltus.effects.effect import map_arrays
from saltus.render.camera import RobotCamera
from saltus.render.stereo.camera import UNFILTERED, StereoCamera, StereoConfig
from saltus.render.stereo.image import ARRAY_WINDOWS
from saltus.render.stereo.matching import Background, DisparityNoise
from saltus.render.stereo.model_view import COLUMNS, ROWS, pool_valid
from saltus.render.stereo.optics import StereoOptics
from saltus.render.stereo_embree import StereoEmbree
from saltus.render.stereo_torch import KorniaWindows
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain

NATIVE = 5  # sensor pixels for each of the model's, along each axis


def terrain(kind: Any = "stairs") -> Terrain:
    return make_terrain(TerrainConfig(terrain=kind))


def poses(count: int, ground: Terrain, seed: int = 0) -> tuple[Any, Any, Any]:
    """Robots in mid-bound anywhere on the course, legs anywhere."""
    rng = np.random.default_rng(seed)
    position = np.stack(
        [rng.uniform(0.0, 4.0, count), rng.uniform(-0.3, 0.3, count), np.zeros(count)], axis=-1
    )
    position[:, 2] = ground.height_at(position[:, 0], position[:, 1]) + rng.uniform(
        0.25, 0.45, count
    )
    yaw, pitch = rng.uniform(-0.4, 0.4, count) / 2, rng.uniform(-0.3, 0.2, count) / 2
    quaternion = np.stack(
        [
            np.cos(yaw) * np.cos(pitch),
            -np.sin(yaw) * np.sin(pitch),
            np.cos(yaw) * np.sin(pitch),
            np.sin(yaw) * np.cos(pitch),
        ],
        axis=-1,
    )
    return position, quaternion, ROBOT.stand_pose + rng.normal(0.0, 0.4, (count, 12))


def run(rows: int, columns: int, config: StereoConfig, scene: Any, frames: int) -> Any:
    """Pooled images of a batch, shape (frames, n, 48, 16);
    `scene(camera, optics)` gives depth and what is hidden.
    """
    camera = supersampled_model_camera(rows, columns)
    optics = StereoOptics.of(camera)
    depth, hidden = scene(camera, optics)
    stereo = StereoCamera(config, optics)
    state = stereo.init(depth.shape[:-2], np.random.default_rng(9))
    images = []
    for k in range(frames):
        image, state = stereo.step(depth, hidden, np.full(depth.shape[:-2], 0.1 * k), state)
        images.append(pool_valid(image.depth, rows, columns))
    return np.stack(images)


def on_stairs(camera: Intrinsics, optics: StereoOptics) -> Any:
    ground = terrain()
    return StereoEmbree(ground, optics, RobotCamera.on(ROBOT, camera)).render_pair_batch(
        *poses(70, ground)
    )


@pytest.mark.sample(1)
@pytest.mark.parametrize("config", [UNFILTERED, StereoConfig()], ids=["unfiltered", "filtered"])
def test_fast_chain_has_the_statistics_of_the_native_one(config: StereoConfig) -> None:
    # Where it meets what is in range, edges are beyond 2 m: see docs
    config = replace(config, background=Background())
    truth = pool_valid(np.minimum(on_stairs(*_native())[0], 100.0), NATIVE, NATIVE)
    native, fast = (
        run(*size, config, on_stairs, 4) for size in ((NATIVE, NATIVE), (ROWS, COLUMNS))
    )
    for near, far in ((0.3, 0.5), (0.5, 0.8), (0.8, 1.2), (1.2, 1.8), (1.8, 2.6)):
        place = (truth >= near) & (truth < far)
        sigma = {}
        for label, images in (("native", native), ("fast", fast)):
            error = (images - truth)[:, place]
            error = error[images[:, place] > 0.0]
            middle = np.median(error)
            assert abs(middle) < 0.003 * near**2, label  # bias
            sigma[label] = 1.4826 * np.median(np.abs(error - middle))
        assert sigma["fast"] == pytest.approx(sigma["native"], rel=0.1)
    assert np.mean(fast == 0.0) == pytest.approx(np.mean(native == 0.0), rel=0.1, abs=0.005)
    for axis in (2, 3):  # by row and by column
        others = tuple(a for a in range(4) if a != axis)
        np.testing.assert_allclose(
            np.mean(fast == 0.0, others), np.mean(native == 0.0, others), atol=0.04
        )


def _native() -> tuple[Intrinsics, StereoOptics]:
    camera = supersampled_model_camera(NATIVE, NATIVE)
    return camera, StereoOptics.of(camera)


def test_fast_chain_has_the_correlation_of_the_native_one() -> None:
    def scene(camera: Intrinsics, optics: StereoOptics) -> Any:
        depth, hidden = flat_wall(camera, 1.0)
        return np.repeat(depth[None], 60, 0), np.repeat(hidden[None], 60, 0)

    found = []
    for rows, columns in ((NATIVE, NATIVE), (ROWS, COLUMNS)):
        noise = run(rows, columns, UNFILTERED, scene, 3) - 1.0
        variance = np.mean(noise**2)
        lags = [np.mean(noise[..., k:, :] * noise[..., :-k, :]) / variance for k in (1, 2, 3)]
        lags += [np.mean(noise[..., k:] * noise[..., :-k]) / variance for k in (1, 2, 3)]
        found.append([1e3 * np.sqrt(variance), *lags])
    np.testing.assert_allclose(found[1][0], found[0][0], rtol=0.08)
    np.testing.assert_allclose(found[1][1:], found[0][1:], atol=0.1)


def test_fast_chain_loses_pixels_where_the_native_one_does() -> None:
    """At the left of a near panel lies its shadow, at the right only what an edge loses."""

    def scene(camera: Intrinsics, optics: StereoOptics) -> Any:
        pairs = [
            wall_and_panel(camera, optics, 1.5, 0.4, left, left + 0.1)
            for left in np.linspace(-0.02, 0.05, 32)
        ]
        return tuple(np.stack(part) for part in zip(*pairs, strict=True))

    native, fast = (
        np.mean(run(*size, UNFILTERED, scene, 3) == 0.0, axis=(0, 1, 2))
        for size in ((5, 5), (ROWS, COLUMNS))
    )
    np.testing.assert_allclose(fast, native, atol=0.08)
    assert np.sum(fast) == pytest.approx(np.sum(native), rel=0.1)
    assert np.sum(native[:8]) > 2.0 * np.sum(native[12:])


def test_a_frame_of_the_native_chain_becomes_the_models_image() -> None:
    camera, optics = _native()
    depth, hidden = StereoEmbree(
        terrain(), optics, RobotCamera.on(ROBOT, camera)
    ).render_pair_batch(*poses(1, terrain(), seed=2))
    stereo = StereoCamera(StereoConfig(), optics)
    image, _ = stereo.step(depth, hidden, np.zeros(1), stereo.init((1,), np.random.default_rng(0)))
    seen = model_image(depth_in_millimetres(image.depth[0]), camera)
    straight = model_image(depth_in_millimetres(pool_valid(image.depth[0], NATIVE, NATIVE)))
    np.testing.assert_array_equal(seen[1], straight[1])
    np.testing.assert_allclose(seen[0], straight[0], atol=1e-3)


def test_torch_gives_the_images_of_numpy() -> None:
    ground, count = terrain(), 40
    robots = poses(count, ground, seed=8)
    camera = supersampled_model_camera(ROWS, COLUMNS)
    optics = StereoOptics.of(camera)
    depth, hidden = StereoEmbree(ground, optics, RobotCamera.on(ROBOT, camera)).render_pair_batch(
        *robots
    )
    by_numpy, by_torch = (
        StereoCamera(StereoConfig(), optics, w) for w in (ARRAY_WINDOWS, KorniaWindows())
    )
    state: Any = by_numpy.init((count,), np.random.default_rng(1))
    memory: Any = map_arrays(torch.from_numpy, state)
    for k in range(3):
        time_s = np.full(count, 0.02 * k)
        image, state = by_numpy.step(depth, hidden, time_s, state)
        tensors = (torch.from_numpy(array) for array in (depth, hidden, time_s))
        on_torch, memory = by_torch.step(*tensors, memory)
    images, found = (pool_valid(each.depth, ROWS, COLUMNS) for each in (image, on_torch))
    assert images.shape == (count, MODEL_CAMERA.height, MODEL_CAMERA.width)
    assert 0.5 < np.mean(images > 0.0) <= 1.0
    assert np.mean(~np.isclose(found.numpy(), images, atol=2e-3)) < 2e-3


def test_cameras_of_one_batch_may_differ() -> None:
    count = 67
    sigma = np.where(np.arange(count) % 2 == 0, 0.02, 0.3)
    config = replace(UNFILTERED, disparity_noise=DisparityNoise(sigma=sigma))

    def level_ground(camera: Intrinsics, optics: StereoOptics) -> Any:
        eye = RobotCamera.on(ROBOT, camera, legs=False)
        position, quaternion = (
            np.tile([0.0, 0.0, 0.3], (count, 1)),
            np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        )
        joints = np.tile(ROBOT.stand_pose, (count, 1))
        return StereoEmbree(terrain("flat"), optics, eye).render_pair_batch(
            position, quaternion, joints
        )

    near = run(ROWS, COLUMNS, config, level_ground, 1)[0, :, 24:]
    spread = np.std(near - np.mean(near, axis=0), axis=(1, 2))
    assert np.min(spread[sigma > 0.1]) > 3.0 * np.max(spread[sigma < 0.1])
