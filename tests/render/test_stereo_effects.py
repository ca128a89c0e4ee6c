"""Laws of the effects of a stereo camera, and what each
of them does in a scene known in closed form.
"""

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
import torch
from stereo_scenes import flat_wall, wall_and_panel

from saltus.config import from_toml, to_toml
from saltus.depth import D435I, Intrinsics
from saltus.effects.effect import Effect, map_arrays
from saltus.effects.signals import DepthImage
from saltus.errors import ConfigError
from saltus.render.stereo.camera import IDEAL_STEREO, UNFILTERED, StereoCamera, StereoConfig
from saltus.render.stereo.image import StereoImage, depth_of, stereo_image
from saltus.render.stereo.matching import Background
from saltus.render.stereo.optics import StereoOptics

SMALL = Intrinsics(width=64, height=40, fx=211.313, fy=211.313, cx=40.0, cy=20.0)
OPTICS = StereoOptics.of(SMALL, sensor=SMALL)
DEFAULTS = StereoConfig()
EXAMPLES = DEFAULTS.effects
CAMERAS = 3
FRAMES = 5


def name(effect: Effect[Any]) -> str:
    return effect.name


def images(effect: Effect[Any], batch: tuple[int, ...]) -> list[Any]:
    """What an effect gets: a panel before a slanted wall,
    whose depth has holes where the effect works on depth.
    """
    depth, hidden = wall_and_panel(SMALL, OPTICS, 1.6, 0.5, -0.04, 0.03, slant=0.4)
    depth[:6, 50:] = np.inf
    signals: list[Any] = []
    rng = np.random.default_rng(2)
    for k in range(FRAMES):
        signal = stereo_image(
            np.broadcast_to(depth, (*batch, *depth.shape)).copy(),
            np.broadcast_to(hidden, (*batch, *depth.shape)).copy(),
            np.full(batch, 0.02 * k),
            OPTICS,
        )
        if isinstance(signal, StereoImage) and is_on_depth(effect):
            lost = rng.random((*batch, *depth.shape)) < 0.2
            finite = np.where(np.isfinite(depth_of(signal)), depth_of(signal), 0.0)
            millimetres = np.round(finite * 1e3 + rng.integers(0, 3, finite.shape)) * 1e-3
            signals.append(
                DepthImage(
                    depth=np.where(lost, 0.0, millimetres).astype(np.float32), time_s=signal.time_s
                )
            )
        else:
            signals.append(signal)
    return signals


def is_on_depth(effect: Effect[Any]) -> bool:
    return effect.name in ("depth_unit", "hole_filling", "spatial_filter", "temporal_filter")


def run(effect: Effect[Any], inputs: list[Any], state: Any) -> list[Any]:
    outputs = []
    for signal in inputs:
        out, state = effect.apply(signal, 0.0, state)
        outputs.append(out)
    return outputs


def arrays(signal: Any) -> list[Any]:
    return [getattr(signal, f.name) for f in fields(signal) if f.name not in ("optics", "windows")]


@pytest.mark.parametrize("effect", EXAMPLES, ids=name)
def test_identity_at_null_to_the_bit(effect: Effect[Any]) -> None:
    null = type(effect)()
    assert null.is_null()
    assert not effect.is_null()
    inputs = images(effect, (CAMERAS,))
    for before, after in zip(
        inputs, run(null, inputs, null.init((CAMERAS,), np.random.default_rng(1))), strict=True
    ):
        for a, b in zip(arrays(before), arrays(after), strict=True):
            assert a.tobytes() == b.tobytes()


@pytest.mark.parametrize("effect", EXAMPLES, ids=name)
def test_every_effect_changes_something_and_leaves_its_input_alone(effect: Effect[Any]) -> None:
    inputs = images(effect, (2, 2))
    copies = [map_arrays(np.copy, signal) for signal in inputs]
    outputs = run(effect, inputs, effect.init((2, 2), np.random.default_rng(1)))
    changed = False
    for before, copy, after in zip(inputs, copies, outputs, strict=True):
        for a, c, b in zip(arrays(before), arrays(copy), arrays(after), strict=True):
            np.testing.assert_array_equal(a, c)
            assert (b.shape, b.dtype) == (a.shape, a.dtype)
            changed |= not np.array_equal(a, b)
    # at delta 1 and noise above it, the temporal filter finds nothing that agrees: tests of the
    # post-filters
    assert changed or effect.name == "temporal_filter"


@pytest.mark.parametrize("effect", EXAMPLES, ids=name)
def test_batched_is_one_by_one(effect: Effect[Any]) -> None:
    inputs = images(effect, (CAMERAS,))
    state = effect.init((CAMERAS,), np.random.default_rng(1))
    together = run(effect, inputs, state)
    for i in range(CAMERAS):
        alone = run(
            effect,
            [map_arrays(lambda a, i=i: a[i], s) for s in inputs],
            map_arrays(lambda a, i=i: a[i], state),
        )
        for one, all_of_them in zip(alone, together, strict=True):
            for a, b in zip(arrays(one), arrays(all_of_them), strict=True):
                np.testing.assert_array_equal(a, b[i])


@pytest.mark.parametrize("effect", EXAMPLES, ids=name)
def test_torch_agrees_with_numpy(effect: Effect[Any]) -> None:
    inputs = images(effect, (CAMERAS,))
    state = effect.init((CAMERAS,), np.random.default_rng(1))
    expected = run(effect, inputs, state)
    outputs = run(
        effect,
        [map_arrays(torch.from_numpy, s) for s in inputs],
        map_arrays(torch.from_numpy, state),
    )
    for want, got in zip(expected, outputs, strict=True):
        for a, b in zip(arrays(want), arrays(got), strict=True):
            assert a.dtype == b.numpy().dtype
            if a.dtype == bool:
                assert np.mean(a != b.numpy()) < 1e-3  # thresholds may be met within rounding
            else:
                # a rounding that falls the other way moves a disparity by a step
                assert np.mean(~np.isclose(a, b.numpy(), rtol=1e-5)) < 1e-3


@pytest.mark.parametrize("effect", EXAMPLES, ids=name)
def test_seed_decides(effect: Effect[Any]) -> None:
    inputs = images(effect, (CAMERAS,))
    one, two = (
        run(effect, inputs, effect.init((CAMERAS,), np.random.default_rng(5))) for _ in range(2)
    )
    for a, b in zip(one, two, strict=True):
        for x, y in zip(arrays(a), arrays(b), strict=True):
            assert x.tobytes() == y.tobytes()


def test_config_survives_toml() -> None:
    config = replace(DEFAULTS, disparity_noise=replace(DEFAULTS.disparity_noise, sigma=0.05))
    assert from_toml(StereoConfig, to_toml(config)) == config
    assert from_toml(StereoConfig, to_toml(IDEAL_STEREO)) == IDEAL_STEREO
    with pytest.raises(ConfigError, match="sigma"):
        from_toml(StereoConfig, "[disparity_noise]\nsigma = -1.0\n")


def test_ideal_camera_returns_what_it_gets() -> None:
    depth, hidden = wall_and_panel(SMALL, OPTICS, 1.6, 0.5, -0.04, 0.03)
    camera = StereoCamera(IDEAL_STEREO, OPTICS)
    image, _ = camera.step(
        depth, hidden, np.asarray(0.0), camera.init((), np.random.default_rng(0))
    )
    assert image.depth is depth


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_impossible_optics_are_refused(value: float) -> None:
    with pytest.raises(ConfigError, match="focal length"):
        StereoOptics.of(replace(SMALL, fx=value))
    with pytest.raises(ConfigError, match="baseline_m"):
        StereoOptics.of(SMALL, baseline_m=value)


def only(*names: str, **changes: Any) -> StereoConfig:
    return replace(DEFAULTS.only(names), **changes)


def series(
    config: StereoConfig,
    optics: StereoOptics,
    depth: Any,
    hidden: Any,
    frames: int,
    period_s: float = 1.0,
) -> Any:
    camera = StereoCamera(config, optics)
    state = camera.init((), np.random.default_rng(4))
    result = []
    for k in range(frames):
        image, state = camera.step(depth, hidden, np.asarray(period_s * k), state)
        result.append(image.depth)
    return np.stack(result)


@pytest.mark.parametrize("depth_m", [0.3, 0.5, 1.0, 2.0, 3.0])
def test_axial_noise_is_that_of_stereo(depth_m: float) -> None:
    """After quantisation of the disparity, z^2 s / (f B) within 10 %;
    whole millimetres add to it at 0.3 m.
    """
    crop = replace(D435I, width=200, height=120, cx=100.0)
    optics = StereoOptics.of(crop)
    depth, hidden = flat_wall(crop, depth_m)
    frames = series(only("disparity_noise", "disparity_step"), optics, depth, hidden, 12)
    expected = depth_m**2 * 0.08 / optics.disparity_at_1m
    assert np.std(frames) == pytest.approx(expected, rel=0.1)
    if depth_m >= 0.5:
        frames = series(
            only("disparity_noise", "disparity_step", "depth_unit"), optics, depth, hidden, 12
        )
        assert np.std(frames) == pytest.approx(expected, rel=0.1)
    assert np.mean(frames) == pytest.approx(
        depth_m, abs=0.15 * expected + 2.0 * expected**2 / depth_m
    )


def test_noise_is_correlated_over_the_window_and_from_frame_to_frame() -> None:
    crop = replace(D435I, width=200, height=120)
    depth, hidden = flat_wall(crop, 1.0)
    noise = (
        series(only("disparity_noise"), StereoOptics.of(crop), depth, hidden, 40, period_s=0.02)
        - 1.0
    )
    variance = np.mean(noise**2)
    for axis in (1, 2):
        lagged = np.mean(
            np.take(noise, range(9, noise.shape[axis]), axis)
            * np.take(noise, range(noise.shape[axis] - 9), axis)
        )
        assert lagged / variance == pytest.approx(math.exp(-1.0), abs=0.06)
    assert np.mean(noise[1:] * noise[:-1]) / variance == pytest.approx(0.5, abs=0.06)


def test_left_band_and_minimum_depth_are_those_of_the_geometry() -> None:
    optics = StereoOptics.of(D435I)
    for depth_m in (0.15, 0.3, 1.0):
        depth, hidden = flat_wall(D435I, depth_m)
        (frame,) = series(only("search_range"), optics, depth, hidden, 1)
        invalid = np.mean(frame == 0.0, axis=0)
        assert set(invalid) <= {0.0, 1.0}
        assert np.sum(invalid) == pytest.approx(optics.disparity_at_1m / depth_m, abs=1.0)
        assert np.all(np.diff(invalid) <= 0.0)
    for factor, seen in ((0.98, False), (1.02, True)):
        depth, hidden = flat_wall(D435I, factor * optics.disparity_at_1m / 126.0)
        (frame,) = series(only("search_range"), optics, depth, hidden, 1)
        assert np.any(frame > 0.0) == seen


def test_shadow_lies_left_of_what_is_near_and_is_as_wide_as_the_geometry() -> None:
    optics = StereoOptics.of(D435I)
    depth, hidden = wall_and_panel(D435I, optics, 2.0, 0.5, -0.3, 0.2)
    (frame,) = series(only("baseline_occlusion"), optics, depth, hidden, 1)
    columns = np.flatnonzero(frame[0] == 0.0)
    edge = np.flatnonzero(depth[0] == np.float32(0.5))[0]
    assert columns[-1] == edge - 1
    assert len(columns) == pytest.approx(optics.disparity_at_1m * (1 / 0.5 - 1 / 2.0), abs=1.0)


def test_edge_holes_and_flying_pixels_stay_at_edges() -> None:
    optics = StereoOptics.of(D435I)
    depth, hidden = wall_and_panel(D435I, optics, 2.0, 0.5, -0.3, 0.2)
    config = only(
        "edge_holes", "flying_pixels", edge_holes=replace(DEFAULTS.edge_holes, fraction=0.3)
    )
    frames = series(config, optics, depth, hidden, 20)
    panel = depth[0] == np.float32(0.5)
    first, last = np.flatnonzero(panel)[[0, -1]]
    invalid = np.mean(frames == 0.0, axis=(0, 1))
    reach = np.r_[first - 5 : first, last + 1 : last + 6]
    assert np.sum(invalid[reach]) / 9.0 == pytest.approx(0.3, abs=0.03)  # 4.5 px on both sides
    invalid[reach] = 0.0
    assert not np.any(invalid)
    moved = np.mean((frames > 0.0) & (abs(frames - depth) > 0.01), axis=(0, 1))
    np.testing.assert_array_equal(np.flatnonzero(moved), [first - 1, first, last, last + 1])
    assert np.all(frames[frames > 0.0] <= 2.0 + 1e-6)
    assert moved[[first, last]] == pytest.approx([0.2, 0.2], abs=0.03)


def test_far_and_grazing_surfaces_are_lost() -> None:
    crop = replace(D435I, width=80, height=60, cx=40.0, cy=30.0)
    optics = StereoOptics.of(crop)
    share = [
        np.mean(series(only("weak_signal"), optics, *flat_wall(crop, z), 4) == 0.0)
        for z in (3.0, 10.0, 30.0)
    ]
    assert share[0] < 0.01
    assert share[1] == pytest.approx(0.5, abs=0.1)
    assert share[2] > 0.95
    grazing = wall_and_panel(crop, optics, 3.0, 3.0, 9.0, 9.0, slant=8.0)[0]
    behind = (grazing < 0.0) | (grazing > 3.5)
    grazing[behind] = 3.5
    lost = (
        series(only("weak_signal"), optics, grazing, np.zeros_like(behind), 4)[:, :, 30:40] == 0.0
    )
    assert np.mean(lost) > share[0] + 0.01


@pytest.mark.parametrize("distance", [4.0, 6.0, 10.0])
def test_where_nothing_is_hit_the_camera_looks_at_a_wall(distance: float) -> None:
    """It is seen as a real wall there would be: as noisily, and lost as often."""
    reported = []
    for depth in (np.full((40, 64), distance), np.full((40, 64), np.inf)):
        config = replace(UNFILTERED, background=Background(distance=distance))
        reported.append(series(config, OPTICS, depth, np.zeros(depth.shape, np.bool_), 4))
    np.testing.assert_array_equal(reported[0], reported[1])
    assert 0.0 < np.mean(reported[0] == 0.0) < 0.7
    near = only("background", background=Background(distance=distance))
    scene = np.linspace(0.1, 0.999 * distance, 40 * 64).reshape(40, 64)
    np.testing.assert_allclose(
        series(near, OPTICS, scene, np.zeros(scene.shape, np.bool_), 1)[0], scene, rtol=1e-6
    )


def test_without_a_background_nothing_is_what_is_seen() -> None:
    depth = np.full((40, 64), np.inf)
    config = replace(UNFILTERED, background=Background())
    assert not np.any(series(config, OPTICS, depth, np.zeros(depth.shape, np.bool_), 2))


def test_order_of_effects_is_that_of_the_camera() -> None:
    assert [e.name for e in EXAMPLES] == [f.name for f in fields(StereoConfig)]
    assert [e.name for e in UNFILTERED.effects if not e.is_null()] == [e.name for e in EXAMPLES[:9]]
