"""Cameras as values: TOML forms, rates, ranges, mounts, and what the network gets of them."""

import re
from dataclasses import fields, replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from samples import PROFILE, ROBOT, level_truth

from saltus.config import TerrainConfig
from saltus.depth import D435I, MODEL_CAMERA, Intrinsics, depth_in_millimetres, model_image
from saltus.depth_camera import SHIPPED, DepthCamera, load_camera, recorded_camera
from saltus.effects.camera import CameraChain
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.profile import IDEAL, Profile
from saltus.errors import ConfigError
from saltus.render.camera import RobotCamera
from saltus.render.embree import EmbreeRenderer
from saltus.render.exposure import PerfectExposure
from saltus.render.process import CameraProcess
from saltus.render.stereo.camera import IDEAL_STEREO, UNFILTERED, StereoConfig
from saltus.render.stereo.optics import StereoOptics
from saltus.terrain.curriculum import make_terrain

EXAMPLE = load_camera(str(Path(__file__).parents[2] / "examples" / "camera.toml"))
NARROW = replace(
    EXAMPLE, image=Intrinsics(width=90, height=60, fx=200.0, fy=150.0, cx=45.0, cy=20.0)
)
CAMERAS = [
    *SHIPPED.values(),
    EXAMPLE,
    replace(
        NARROW, sensor=Intrinsics(width=640, height=480, fx=200.0, fy=150.0, cx=320.0, cy=240.0)
    ),
    replace(
        SHIPPED["d435i"],
        name="fast",
        rate_hz=100.0,
        range_m=(0.3, 1.0),
        stereo={"depth_unit": {"unit": 0.01}},
    ),
]
TERRAIN = make_terrain(TerrainConfig(terrain="stairs", rise_m=0.1))


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.name)
def test_a_camera_reads_back_equal_from_its_toml_and_from_a_record(camera: DepthCamera) -> None:
    assert DepthCamera.from_toml(camera.to_toml()) == camera
    assert recorded_camera(camera.record) == camera
    assert isinstance(camera.record, str) == (camera.name in SHIPPED)


def test_a_file_changes_what_it_names(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("camera_pitch = 0.4\n[stereo.disparity_noise]\nsigma = 0.2\n")
    camera, base = load_camera(str(path)), SHIPPED["d435i"]
    assert camera == replace(
        base, name="mine", camera_pitch=0.4, stereo={"disparity_noise": {"sigma": 0.2}}
    )
    errors = StereoConfig.of(camera)
    assert errors == replace(
        StereoConfig(), disparity_noise=replace(StereoConfig().disparity_noise, sigma=0.2)
    )
    assert StereoConfig.of(base) == StereoConfig()
    assert StereoConfig.of(SHIPPED["ideal"]) == IDEAL_STEREO
    width, height = (
        2.0 * np.degrees(np.arctan(0.5 * n / f))
        for n, f in ((640, EXAMPLE.image.fx), (480, EXAMPLE.image.fy))
    )
    assert (width, height) == (pytest.approx(87.0), pytest.approx(58.0))


def test_the_whole_image_of_a_d435i_has_the_errors_of_its_sensor_and_no_filters() -> None:
    whole = SHIPPED["d435i_whole"]
    optics = StereoOptics.behind(whole.image, whole)
    assert (optics.focal_px, optics.pitch_x, optics.pitch_y) == pytest.approx((D435I.fx, 6.0, 6.0))
    assert optics.first_column == pytest.approx(0.0)
    assert StereoConfig.of(whole) == UNFILTERED
    assert (6 * whole.image.width, 6 * whole.image.height) == (420, 240)  # of 424 x 240


WRONG = ('"here"', "true", "3.5", "[1, 2]", "[[1]]", '["a", "b", "c"]', "{ here = 1 }")


def test_what_is_wrong_in_a_file_is_said_in_words_of_people(tmp_path: Path) -> None:
    leaves = [f"{table}.{name}" for table in ("sensor", "image") for name in vars(EXAMPLE.image)]
    keys = [
        *(f.name for f in fields(DepthCamera)),
        *leaves,
        "image.fov_deg",
        "stereo.depth_unit",
        "stereo.depth_unit.unit",
    ]
    said: dict[str, list[str]] = {key: [] for key in keys}
    for key, value in product(keys, WRONG):
        (tmp_path / "wrong.toml").write_text(f"{key} = {value}\n")
        try:
            StereoConfig.of(load_camera(str(tmp_path / "wrong.toml")))
        except ConfigError as error:
            said[key].append(str(error).removeprefix(str(tmp_path)))
    for key, messages in said.items():
        assert len(messages) > 3
        for message in messages:
            assert any(part in message for part in key.split("."))
            assert not re.search(
                r"\b(int|float|bool|str|tuple|dict|list\[|None|numpy|saltus|type|class)\b", message
            )


@pytest.mark.parametrize("table", ["image", "sensor"])
def test_an_image_and_a_sensor_are_named_as_a_whole(table: str, tmp_path: Path) -> None:
    whole, path = {"width": 640, "height": 480, "fx": 600.0, "fy": 590.0}, tmp_path / "own.toml"
    angles = [
        float(np.degrees(2.0 * np.arctan(0.5 * n / f))) for n, f in ((640, 600.0), (480, 590.0))
    ]
    for name in whole:
        path.write_text(
            f"[{table}]\n" + "".join(f"{key} = {whole[key]}\n" for key in whole if key != name)
        )
        with pytest.raises(ConfigError, match=rf"\[{table}\] must name .*; it lacks {name}$"):
            load_camera(str(path))
    for given in (whole, {"width": 640, "height": 480, "fov_deg": angles}):
        path.write_text(
            f"[{table}]\n" + "".join(f"{key} = {value}\n" for key, value in given.items())
        )
        named = vars(getattr(load_camera(str(path)), table))
        assert named == pytest.approx({**whole, "cx": 320.0, "cy": 240.0})


def test_it_sits_where_it_says_and_else_where_the_robot_has_its_own() -> None:
    assert SHIPPED["d435i"].mounted_on(ROBOT) is ROBOT
    own = EXAMPLE.mounted_on(ROBOT)
    np.testing.assert_allclose(own.camera_position - ROBOT.camera_position, [0.0, 0.0, 0.05])
    assert own.camera_pitch == pytest.approx(np.radians(25.0), abs=1e-4)
    tilted = replace(SHIPPED["d435i"], camera_pitch=0.1).mounted_on(ROBOT)
    np.testing.assert_array_equal(tilted.camera_position, ROBOT.camera_position)


def test_its_latency_takes_the_place_of_the_profiles() -> None:
    assert SHIPPED["d435i"].delivered(PROFILE) is PROFILE
    for profile in (IDEAL, PROFILE, Profile(camera=(CameraLatency(latency=0.07, jitter=0.01),))):
        known = [effect for effect in profile.camera if isinstance(effect, CameraLatency)] or [
            CameraLatency()
        ]
        assert EXAMPLE.delivered(profile).camera == (replace(known[0], latency=0.04),)


@pytest.mark.parametrize("rate_hz", [20.0, 25.0, 30.0, 50.0, 60.0, 90.0, 100.0])
def test_images_are_taken_at_the_rate_and_never_early(rate_hz: float) -> None:
    camera = replace(EXAMPLE, rate_hz=rate_hz, latency_s=0.0)
    steps = camera.exposures(300)
    assert len(steps) == 3 * rate_hz
    late_s = 0.01 * steps - np.arange(len(steps)) / rate_hz
    assert (late_s > -1e-9).all()
    assert (late_s < 0.01).all()
    assert [k for k in range(300) if camera.exposes(k)] == steps.tolist()
    exposure = PerfectExposure(EmbreeRenderer(TERRAIN, RobotCamera.on(ROBOT)))
    process = CameraProcess(camera, exposure, CameraChain(()), np.random.default_rng(0))
    sent = [process.step(level_truth(k, 0.01 * k, 0.3), 10_000_000 * k) for k in range(40)]
    assert [k for k, frame in enumerate(sent) if frame is not None] == camera.exposures(40).tolist()
    assert process.overruns == 0


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.name)
def test_the_network_gets_from_images_of_its_own_size_what_it_gets_from_the_cameras(
    camera: DepthCamera,
) -> None:
    """Training renders the one, a run sends the other:
    the same is valid, and away from edges equally far.
    """
    robot, truth = camera.mounted_on(ROBOT), level_truth(0, 0.8, 0.3)
    pose = truth.position_base_in_world, truth.quaternion_base_in_world, truth.joint_position
    sent, small = (
        EmbreeRenderer(TERRAIN, RobotCamera.on(robot, view)).render(*pose)
        for view in (camera.image, MODEL_CAMERA)
    )
    run = model_image(depth_in_millimetres(camera.in_range(sent)), camera.image)
    training = model_image(depth_in_millimetres(camera.masked(small)))
    assert (run[1] != training[1]).mean() < (0.0 if camera.range_m is None else 0.1) + 1e-9
    both = (run[1] > 0.0) & (training[1] > 0.0)
    assert both.mean() > 0.05
    assert np.median(np.abs(run[0] - training[0])[both]) < 0.003
