"""What each effect of a camera does to an image or to the camera."""

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from memory_bus import MemoryBus, MemoryHub
from samples import ROBOT, level_truth, put_run

from saltus.config import RunConfig, TerrainConfig
from saltus.depth import BASELINE_M, MODEL_CAMERA, intrinsics_of, model_image
from saltus.effects import depth_errors
from saltus.effects.camera import CameraChain, CameraFov, CameraHeight, CameraPitch, ViewChain
from saltus.effects.effect import Effect
from saltus.effects.image_delivery import CameraLatency, TemporalSmear
from saltus.effects.profile import Profile, load_profile
from saltus.effects.signals import DepthImage
from saltus.render.__main__ import build
from saltus.render.camera import RobotCamera
from saltus.render.embree import EmbreeRenderer
from saltus.render.exposure import PerfectExposure
from saltus.runtime.process import ProcessContext
from saltus.terrain.curriculum import make_terrain
from saltus.wire.messages import GroundTruth

TERRAIN = make_terrain(TerrainConfig(terrain="step", height_m=0.2))
CLAIMED = RobotCamera.on(ROBOT)
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
HEIGHT_M = 0.3


def applied(effect: Effect[Any], depth: Any, time_s: float = 0.0) -> Any:
    state = effect.init((), np.random.default_rng(0))
    return effect.apply(
        DepthImage(depth=np.asarray(depth, dtype=float), time_s=np.asarray(time_s)), time_s, state
    )[0].depth


def truth(step: int, height_m: float = HEIGHT_M) -> GroundTruth:
    return level_truth(step, 0.6, height_m)


def test_every_effect_of_a_camera_has_its_place() -> None:
    assert {kind.site for kind in CameraChain.order} == {"depth"}
    assert {kind.site for kind in ViewChain.order} == {"view"}


@pytest.mark.parametrize(
    "effect",
    [
        depth_errors.DepthScale(scale=1.1),
        depth_errors.DepthBias(bias=0.1),
        depth_errors.DepthNoise(subpixel_sigma=0.5),
    ],
)
def test_invalid_stays_invalid_and_nothing_stays_nothing(effect: Effect[Any]) -> None:
    depth = applied(effect, [[0.0, np.inf, 1.0]] * 3)
    np.testing.assert_array_equal(depth[:, :2], [[0.0, np.inf]] * 3)
    assert np.all(depth[:, 2] != 1.0)


def test_noise_grows_with_the_square_of_depth() -> None:
    sigma, focal = 0.05, 100.0
    for depth in (0.5, 1.0, 2.0):
        noisy = applied(
            depth_errors.DepthNoise(subpixel_sigma=sigma, focal_px=focal),
            np.full((200, 200), depth),
        )
        expected = depth**2 * sigma / (focal * BASELINE_M)
        assert np.std(noisy) == pytest.approx(expected, rel=0.03)
        assert np.mean(noisy) == pytest.approx(depth, abs=0.05 * expected)


@pytest.mark.parametrize("width", [1, 3, 5])
def test_holes_are_left_of_near_objects_only(width: int) -> None:
    depth = np.full((2, 20), 2.0)
    depth[:, 8:12] = 1.0
    lost = applied(depth_errors.EdgeHoles(width=float(width)), depth) == 0.0
    np.testing.assert_array_equal(np.flatnonzero(lost[0]), np.arange(8 - width, 8))


@pytest.mark.parametrize("reach", [1, 2, 4, 7])
def test_filling_undoes_holes_within_reach(reach: int) -> None:
    depth = np.full((2, 20), 2.0)
    depth[:, 8:12] = 1.0
    holed = applied(depth_errors.EdgeHoles(width=4.0), depth)
    filled = applied(depth_errors.HoleFill(reach=float(reach)), holed)
    assert np.count_nonzero(filled[0] == 0.0) == max(4 - reach, 0)
    assert np.all((filled == depth) | (filled == 0.0))


def test_clipping_reads_far_as_the_end() -> None:
    np.testing.assert_array_equal(
        applied(depth_errors.RangeClip(max=2.0), [[0.0, 1.0, 2.5, np.inf]]), [[0.0, 1.0, 2.0, 2.0]]
    )


def test_smear_answers_a_step_with_an_exponential() -> None:
    effect, alpha = TemporalSmear(alpha=0.4), 0.4
    state = None
    for k in range(12):
        image = DepthImage(depth=np.full((1, 1), 1.0 if k else 2.0), time_s=np.asarray(0.02 * k))
        for _ in range(2):  # who looks twice sees the same
            out, state = effect.apply(image, 0.02 * k, state)
            assert out.depth[0, 0] == pytest.approx(1.0 + (1.0 - alpha) ** k, rel=1e-12)


def test_smear_does_not_mix_what_is_invalid() -> None:
    effect, state, seen = TemporalSmear(alpha=0.5), None, []
    for k, z in enumerate([1.0, 0.0, 2.0, np.inf, 3.0, 1.0]):
        out, state = effect.apply(
            DepthImage(depth=np.full((1, 1), z), time_s=np.asarray(0.1 * k)), 0.1 * k, state
        )
        seen.append(float(out.depth[0, 0]))
    assert seen == [1.0, 0.0, 2.0, np.inf, 3.0, 2.0]


def test_the_view_is_what_the_effects_say() -> None:
    view = ViewChain((CameraFov(scale=1.25), CameraHeight(offset=0.02), CameraPitch(offset=-0.1)))
    moved = CLAIMED.moved(view)
    fx, fy = MODEL_CAMERA.fx / 1.25, MODEL_CAMERA.fy / 1.25
    assert (moved.intrinsics.fx, moved.intrinsics.fy) == pytest.approx((fx, fy))
    np.testing.assert_allclose(
        moved.mount.position, ROBOT.camera_position + np.array([0.0, 0.0, 0.02])
    )
    assert moved.mount.pitch == pytest.approx(ROBOT.camera_pitch - 0.1)
    same = CLAIMED.moved(ViewChain())
    assert same.intrinsics == MODEL_CAMERA
    assert (same.mount.position == ROBOT.camera_position).all()


def test_a_higher_camera_sees_what_a_higher_base_sees() -> None:
    """And reports the intrinsics that are claimed, whatever it really has."""
    view = ViewChain((CameraHeight(offset=0.05), CameraFov(scale=1.1)))
    claimed = replace(CLAIMED, legs=False)
    camera = claimed.moved(view)
    moved = PerfectExposure(EmbreeRenderer(TERRAIN, camera), MODEL_CAMERA)
    other = PerfectExposure(EmbreeRenderer(TERRAIN, replace(claimed, intrinsics=camera.intrinsics)))
    np.testing.assert_allclose(
        moved.expose(truth(0)), other.expose(truth(0, HEIGHT_M + 0.05)), rtol=1e-5
    )
    assert moved.intrinsics == MODEL_CAMERA


@pytest.mark.parametrize("camera", ["ideal", "d435i"])
def test_the_camera_process_takes_all_of_a_profile(
    camera: Literal["ideal", "d435i"], tmp_path: Path
) -> None:
    """Its frames are images of the moved camera,
    changed by the effects on images, under the claimed intrinsics.
    """
    effects = (
        CameraPitch(offset=0.1),
        depth_errors.DepthScale(scale=1.1),
        depth_errors.RangeClip(max=1.2),
        CameraLatency(latency=0.03),
    )
    path = tmp_path / "profile.toml"
    path.write_text(Profile(camera=effects).to_toml())
    config = RunConfig(
        robot="go1",
        grid="line",
        terrain=TerrainConfig(terrain="step", height_m=0.2),
        camera=camera,
        renderer="embree",
        profile=str(path),
    )
    process = build(
        ProcessContext(
            "render", config, put_run(tmp_path, config), MemoryBus("robot/0", MemoryHub())
        )
    )
    frame = next(
        frame for k in range(20) if (frame := process.step(truth(k), 10_000_000 * k)) is not None
    )
    moved = EmbreeRenderer(TERRAIN, CLAIMED.moved(load_profile(str(path), ROBOT).view_chain))
    expected = np.minimum(1.1 * moved.render(*pose_of(truth(0))), 1.2)
    image, valid = model_image(frame.depth, intrinsics_of(frame))
    near = (valid > 0.0) & (expected < 1.1)
    assert near.sum() > 50
    np.testing.assert_allclose(np.median((3.0 * image / expected)[near]), 1.0, atol=5e-3)
    assert np.max(3.0 * image[valid > 0.0]) == pytest.approx(1.2, abs=1e-3)
    assert frame.fx / frame.depth.shape[1] == pytest.approx(MODEL_CAMERA.fx / MODEL_CAMERA.width)


def pose_of(message: GroundTruth) -> tuple[Any, Any, Any]:
    return message.position_base_in_world, message.quaternion_base_in_world, message.joint_position
