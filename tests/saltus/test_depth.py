import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from saltus.depth import (
    D435I,
    MODEL_CAMERA,
    NOTHING,
    RANGE_M,
    Intrinsics,
    depth_in_millimetres,
    model_image,
)

WIDE = Intrinsics(width=640, height=480, fx=382.6, fy=382.6, cx=320.9, cy=236.6)
SMALL = Intrinsics(width=40, height=60, fx=50.0, fy=51.0, cx=20.5, cy=30.1)
CAMERAS = (MODEL_CAMERA, D435I, WIDE, SMALL)


def seen(depth: Any, camera: Intrinsics = MODEL_CAMERA, unit_m: float = 0.001) -> tuple[Any, Any]:
    """Depth over the range, and validity; numpy and torch agree, one by one and together."""
    whole = np.asarray(depth, dtype=np.uint16)
    image = model_image(whole, camera, unit_m)
    assert image.dtype == np.float32
    with_others = model_image(np.stack([whole[::-1], whole]), camera, unit_m)[1]
    np.testing.assert_array_equal(with_others, image)
    on_torch = model_image(torch.from_numpy(whole.astype(np.int32)), camera, unit_m)
    np.testing.assert_allclose(on_torch, image, atol=1e-6)
    return image[0], image[1] > 0.0


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
    near, valid = seen(depth)
    expected = np.where(depth == 0, 1.0, np.minimum(depth / 3000.0, 1.0))
    np.testing.assert_allclose(near, expected, atol=1e-7)
    np.testing.assert_array_equal(valid, depth > 0)


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: f"{c.width}x{c.height}")
@pytest.mark.parametrize("gradient", [(0.5, 0.0, 0.0), (0.9, 0.3, 0.5), (1.0, -0.8, 0.6)])
def test_every_camera_sees_the_same_plane(
    camera: Intrinsics, gradient: tuple[float, float, float]
) -> None:
    """The crop is right for any resolution and focal length: pixels look where the model's do."""
    near, valid = seen(np.rint(1000.0 * plane_depth(camera, gradient)), camera)
    expected = plane_depth(MODEL_CAMERA, gradient) / RANGE_M
    assert valid.all()
    error = near - expected
    per_pixel = sum(np.abs(np.gradient(expected, axis=axis)) for axis in (0, 1))
    millimetre = 1e-3 / RANGE_M
    assert (
        np.abs(error) <= millimetre + 0.3 * per_pixel
    ).all()  # no pixel looks a third of a pixel elsewhere
    # Nor do all of them a twentieth
    assert abs(error.mean()) <= millimetre + 0.05 * per_pixel.mean()


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: f"{c.width}x{c.height}")
def test_invalid_is_far_and_marked(camera: Intrinsics) -> None:
    shape = (camera.height, camera.width)
    for value, expected in ((0, False), (NOTHING, True), (4000, True)):
        near, valid = seen(np.full(shape, value), camera)
        assert (near == 1.0).all()
        assert (valid == expected).all()


@pytest.mark.parametrize("share", [0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
def test_half_of_the_area_must_be_valid(share: float) -> None:
    depth = np.full((240, 424), 1500)
    columns = np.round(212 + 5 * (np.arange(-8, 8) + share)).astype(int)
    for left, right in zip(np.arange(172, 252, 5), columns, strict=True):
        depth[:, left:right] = 0
    camera = Intrinsics(
        width=424, height=240, fx=5 * MODEL_CAMERA.fx, fy=5 * MODEL_CAMERA.fy, cx=212.0, cy=120.0
    )
    near, valid = seen(depth, camera)
    assert (valid == (share <= 0.5)).all()
    np.testing.assert_allclose(near, 0.5 if share <= 0.5 else 1.0)  # what is valid is not diluted


def test_what_a_camera_does_not_cover_is_invalid() -> None:
    narrow = replace(D435I, fx=4 * D435I.fx, fy=4 * D435I.fy)
    near, valid = seen(np.full((240, 424), 1500), narrow)
    inside = np.zeros((48, 16), dtype=bool)
    inside[18:30, :] = True  # a quarter of the field of view
    np.testing.assert_array_equal(valid, inside)
    near, valid = seen(np.full((240, 424), 1500), replace(D435I, cx=-1000.0))
    assert not valid.any()
    assert (near == 1.0).all()


@pytest.mark.parametrize(
    ("fx", "fy"), [(640.0, 640.0), (3400.0, 3400.0), (640.0, 3400.0), (3400.0, 640.0)]
)
def test_long_lenses_cost_what_their_images_are_large(fx: float, fy: float) -> None:
    """Each pixel of the model is then the mean of thousands.

    A service with many robots must not wait for it.
    """
    long = Intrinsics(width=1280, height=720, fx=fx, fy=fy, cx=640.0, cy=360.0)
    depth = np.full((long.height, long.width), 1500, np.uint16)
    model_image(depth, long)
    tracemalloc.start()
    near, valid = model_image(depth, long)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # bytes: depth and validity of every pixel, and the same once more
    assert peak < 24 * depth.size
    assert valid.any()
    np.testing.assert_allclose(near[valid > 0.0], 0.5, atol=1e-5)


@pytest.mark.parametrize("unit_m", [0.0001, 0.00025, 0.001, 0.01])
def test_the_depth_unit_is_honoured(unit_m: float) -> None:
    depth = np.full((48, 16), round(0.6 / unit_m))
    depth[0] = NOTHING
    near, _ = seen(depth, MODEL_CAMERA, unit_m)
    np.testing.assert_allclose(near[1:], 0.2, atol=1e-6)
    assert (near[0] == 1.0).all()


def test_frames_are_whole_millimetres() -> None:
    depth_m, expected = (
        np.array([0.4567, np.inf, 70.0, 3.0], dtype=np.float32),
        [457, NOTHING, NOTHING, 3000],
    )
    encoded, on_torch = (
        depth_in_millimetres(depth_m),
        depth_in_millimetres(torch.from_numpy(depth_m)),
    )
    assert (encoded.dtype, on_torch.dtype) == (np.uint16, torch.int32)
    for found in (encoded, on_torch):
        np.testing.assert_array_equal(found, expected)
