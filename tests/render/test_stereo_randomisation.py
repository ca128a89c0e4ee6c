"""Cameras that differ from robot to robot."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from samples import ROBOT

from saltus.config import from_toml, to_toml
from saltus.depth import MODEL_CAMERA
from saltus.effects.signals import DepthImage
from saltus.errors import ConfigError
from saltus.render.camera import Mount, camera_pose
from saltus.render.randomisation import CameraDraw, CameraRandomisation, Uniform
from saltus.render.stereo.camera import StereoConfig
from saltus.render.stereo.sensor_freeze import SensorFreeze
from saltus.rotations import rotation_matrix

COUNT = 400
ANY = CameraRandomisation()


def test_draws_fill_their_distributions_and_a_seed_repeats_them() -> None:
    draw, again = (ANY.draw(COUNT, np.random.default_rng(3)) for _ in range(2))
    for f in fields(draw):
        np.testing.assert_array_equal(getattr(draw, f.name), getattr(again, f.name))
    for name in ("latency_s", "jitter_s", "drop_fraction", "freeze_s", "noise_strength", "focal_scale"):
        limits, values = getattr(ANY, name), getattr(draw, name)
        assert np.all((values >= limits.low) & (values <= limits.high))
        assert np.ptp(values) > 0.9 * (limits.high - limits.low)


def test_survives_toml_and_refuses_what_falls() -> None:
    config = replace(ANY, latency_s=Uniform(low=0.01, high=0.02))
    assert from_toml(CameraRandomisation, to_toml(config)) == config
    with pytest.raises(ConfigError, match="rise"):
        Uniform(low=1.0, high=0.0)


def test_moved_bases_show_one_mount_what_the_drawn_mounts_see() -> None:
    rng = np.random.default_rng(0)
    draw = replace_roll(ANY.draw(COUNT, rng), 0.0)
    position = rng.normal(0.0, 1.0, (COUNT, 3))
    quaternion = rng.normal(0.0, 1.0, (COUNT, 4))
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    mount = Mount.of(ROBOT)
    centre, rotation = camera_pose(mount, *draw.moved(mount, position, quaternion))
    for i in range(COUNT):
        drawn = Mount(position=mount.position + draw.position[i], pitch=mount.pitch + draw.pitch[i])
        want = camera_pose(drawn, position[i], quaternion[i])
        np.testing.assert_allclose(centre[i], want[0], atol=1e-12)
        np.testing.assert_allclose(rotation[i], want[1], atol=1e-12)


def replace_roll(draw: CameraDraw, roll: float) -> CameraDraw:
    return replace(draw, roll=np.full(COUNT, roll))


def test_roll_turns_about_the_optical_axis_and_moves_nothing() -> None:
    draw = ANY.draw(COUNT, np.random.default_rng(1))
    draw = replace_roll(replace(draw, pitch=np.zeros(COUNT), position=np.zeros((COUNT, 3))), 0.02)
    base = np.zeros((COUNT, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (COUNT, 1))
    centre, rotation = camera_pose(Mount.of(ROBOT), *draw.moved(Mount.of(ROBOT), *base))
    np.testing.assert_allclose(centre, np.tile(Mount.of(ROBOT).position, (COUNT, 1)), atol=1e-12)
    np.testing.assert_allclose(rotation[..., 2], np.tile(Mount.of(ROBOT).rotation[:, 2], (COUNT, 1)), atol=1e-12)
    cosine = np.einsum("nij,ij->n", rotation[..., :2], Mount.of(ROBOT).rotation[:, :2]) / 2.0
    np.testing.assert_allclose(cosine, math.cos(0.02), atol=1e-9)
    assert rotation_matrix(draw.moved(Mount.of(ROBOT), *base)[1]).shape == (COUNT, 3, 3)


def test_stereo_follows_the_strength_and_the_intrinsics_the_scale() -> None:
    draw = ANY.draw(COUNT, np.random.default_rng(1))
    config = draw.stereo(StereoConfig())
    np.testing.assert_allclose(config.disparity_noise.sigma, 0.08 * draw.noise_strength)
    assert np.max(config.edge_holes.fraction) <= 1.0
    camera = draw.intrinsics(MODEL_CAMERA, 5, pitch_px=5.0)
    assert camera.fx == pytest.approx(MODEL_CAMERA.fx * draw.focal_scale[5])
    assert camera.cx == pytest.approx(MODEL_CAMERA.cx + draw.principal_px[5, 0] / 5.0)


def test_link_and_freeze_work_for_a_batch() -> None:
    draw = ANY.draw(COUNT, np.random.default_rng(1))
    chain = draw.link
    state = chain.init((COUNT,), np.random.default_rng(2))
    arrived = np.zeros(COUNT)
    for k in range(30):
        now = 0.01 * k
        exposed = DepthImage(depth=np.full((COUNT, 2, 2), 1.0 + k // 2), time_s=np.full(COUNT, 0.02 * (k // 2)))
        image, state = chain.step(exposed, now, state)
        arrived = np.where(np.isfinite(image.time_s), now - image.time_s, np.inf)
    assert np.all(arrived >= draw.latency_s - draw.jitter_s - 1e-9)
    assert np.mean(arrived < draw.latency_s + draw.jitter_s + 0.0401) > 0.8  # the others have lost the last frame


def test_a_frozen_sensor_repeats_its_depth_with_new_times() -> None:
    freeze = SensorFreeze(rate=2.0, duration=0.1)
    state = freeze.init((COUNT,), np.random.default_rng(2))
    shown = []
    for k in range(500):
        image = DepthImage(depth=np.full((COUNT, 1, 1), float(k)), time_s=np.full(COUNT, 0.02 * k))
        out, state = freeze.apply(image, 0.0, state)
        np.testing.assert_array_equal(out.time_s, image.time_s)
        shown.append(k - out.depth[:, 0, 0])
    stale = np.stack(shown)
    assert np.max(stale) == 5.0  # 0.1 s at 50 Hz
    # frozen for 0.1 s after 0.5 s of sight on average
    assert np.mean(stale > 0.0) == pytest.approx(0.1 / (0.5 + 0.1), rel=0.1)
    assert SensorFreeze().is_null()
