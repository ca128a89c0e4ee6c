import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from saltus.depth import (
    D435I,
    MODEL_CAMERA,
    NOTHING,
    RANGE_M,
    Intrinsics,
    depth_in_millimetres,
    model_image,
    model_images,
)
from saltus.wire.messages import DepthFrame

WIDE = Intrinsics(width=640, height=480, fx=382.6, fy=382.6, cx=320.9, cy=236.6)
SMALL = Intrinsics(width=40, height=60, fx=50.0, fy=51.0, cx=20.5, cy=30.1)
CAMERAS = (MODEL_CAMERA, D435I, WIDE, SMALL)


def frame(depth: Any, camera: Intrinsics, unit_m: float = 0.001) -> DepthFrame:
    return DepthFrame(
        time_ns=0,
        frame_id=0,
        depth=np.asarray(depth, dtype=np.uint16),
        depth_unit_m=unit_m,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
    )


def plane_depth(camera: Intrinsics, gradient: tuple[float, float, float]) -> Any:
    """Depth [m] of a plane: 1 / depth is linear in the tangents of the viewing direction."""
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    return 1.0 / (gradient[0] + gradient[1] * x + gradient[2] * y[:, None])


def test_the_models_own_frame_keeps_its_pixels() -> None:
    rng = np.random.default_rng(0)
    depth = rng.integers(0, 5000, (48, 16)).astype(np.uint16)
    depth[rng.random((48, 16)) < 0.1] = NOTHING
    depth[rng.random((48, 16)) < 0.1] = 0
    image = model_image(frame(depth, MODEL_CAMERA))
    expected = np.where(depth == 0, 1.0, np.minimum(depth / 3000.0, 1.0))
    np.testing.assert_allclose(image.depth, expected, atol=1e-7)
    np.testing.assert_array_equal(image.valid, depth > 0)
    assert (image.depth.dtype, image.valid.dtype) == (np.float32, np.bool_)


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: f"{c.width}x{c.height}")
@pytest.mark.parametrize("gradient", [(0.5, 0.0, 0.0), (0.9, 0.3, 0.5), (1.0, -0.8, 0.6)])
def test_every_camera_sees_the_same_plane(camera: Intrinsics, gradient: tuple[float, float, float]) -> None:
    """The crop is right for any resolution and focal length: pixels look where the model's do."""
    image = model_image(frame(np.rint(1000.0 * plane_depth(camera, gradient)), camera))
    expected = plane_depth(MODEL_CAMERA, gradient) / RANGE_M
    assert image.valid.all()
    error = image.depth - expected
    per_pixel = sum(np.abs(np.gradient(expected, axis=axis)) for axis in (0, 1))
    millimetre = 1e-3 / RANGE_M
    assert (np.abs(error) <= millimetre + 0.3 * per_pixel).all()  # no pixel looks a third of a pixel elsewhere
    assert abs(error.mean()) <= millimetre + 0.05 * per_pixel.mean()  # nor do all of them a twentieth


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: f"{c.width}x{c.height}")
def test_invalid_is_far_and_marked(camera: Intrinsics) -> None:
    shape = (camera.height, camera.width)
    for value, valid in ((0, False), (NOTHING, True), (4000, True)):
        image = model_image(frame(np.full(shape, value), camera))
        assert (image.depth == 1.0).all()
        assert (image.valid == valid).all()


@pytest.mark.parametrize("share", [0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
def test_half_of_the_area_must_be_valid(share: float) -> None:
    depth = np.full((240, 424), 1500)
    columns = np.round(212 + 5 * (np.arange(-8, 8) + share)).astype(int)
    for left, right in zip(np.arange(172, 252, 5), columns, strict=True):
        depth[:, left:right] = 0
    camera = Intrinsics(width=424, height=240, fx=5 * MODEL_CAMERA.fx, fy=5 * MODEL_CAMERA.fy, cx=212.0, cy=120.0)
    image = model_image(frame(depth, camera))
    assert (image.valid == (share <= 0.5)).all()
    np.testing.assert_allclose(image.depth, 0.5 if share <= 0.5 else 1.0)  # what is valid is not diluted


def test_what_a_camera_does_not_cover_is_invalid() -> None:
    narrow = replace(D435I, fx=4 * D435I.fx, fy=4 * D435I.fy)
    image = model_image(frame(np.full((240, 424), 1500), narrow))
    inside = np.zeros((48, 16), dtype=bool)
    inside[18:30, :] = True  # a quarter of the field of view
    np.testing.assert_array_equal(image.valid, inside)
    aside = model_image(frame(np.full((240, 424), 1500), replace(D435I, cx=-1000.0)))
    assert not aside.valid.any()
    assert (aside.depth == 1.0).all()


@pytest.mark.parametrize(("fx", "fy"), [(640.0, 640.0), (3400.0, 3400.0), (640.0, 3400.0), (3400.0, 640.0)])
def test_long_lenses_cost_what_their_images_are_large(fx: float, fy: float) -> None:
    """Each pixel of the model is then the mean of thousands; a service with many robots must not wait for it."""
    long = frame(np.full((720, 1280), 1500), Intrinsics(width=1280, height=720, fx=fx, fy=fy, cx=640.0, cy=360.0))
    model_image(long)
    tracemalloc.start()
    image = model_image(long)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 24 * long.depth.size  # bytes: depth and validity of every pixel, and the same once more
    assert image.valid.any()
    np.testing.assert_allclose(image.depth[image.valid], 0.5, atol=1e-5)


@pytest.mark.parametrize("unit_m", [0.0001, 0.00025, 0.001, 0.01])
def test_the_depth_unit_is_honoured(unit_m: float) -> None:
    depth = np.full((48, 16), round(0.6 / unit_m))
    depth[0] = NOTHING
    image = model_image(frame(depth, MODEL_CAMERA, unit_m))
    np.testing.assert_allclose(image.depth[1:], 0.2, atol=1e-6)
    assert (image.depth[0] == 1.0).all()


def test_rendered_images_take_the_same_way() -> None:
    depth_m = np.random.default_rng(1).uniform(0.2, 4.0, (6, 48, 16)).astype(np.float32)
    depth_m[:, :3] = np.inf
    batch = model_images(depth_m)
    assert batch.valid.all()
    for i in range(6):
        one = model_image(frame(depth_in_millimetres(depth_m[i]), MODEL_CAMERA))
        np.testing.assert_allclose(batch.depth[i], one.depth, atol=0.51e-3 / RANGE_M)
        np.testing.assert_array_equal(batch.valid[i], one.valid)
    broken = model_images(np.array([[0.0, np.nan, 1.5]], dtype=np.float32))
    np.testing.assert_array_equal(broken.valid, [[False, False, True]])
    np.testing.assert_allclose(broken.depth, [[1.0, 1.0, 0.5]])


def test_frames_are_whole_millimetres() -> None:
    encoded = depth_in_millimetres(np.array([0.4567, np.inf, 70.0, 3.0], dtype=np.float32))
    np.testing.assert_array_equal(encoded, np.array([457, NOTHING, NOTHING, 3000], dtype=np.uint16))
