"""The fit finds the parameters of hidden cameras, and says what a recording cannot show."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stereo_scenes import flat_wall, wall_and_panel

from benchmarks.render_fit import frames_of
from saltus.depth import D435I
from saltus.depth_camera import load_camera
from saltus.errors import RecordingError
from saltus.render.fit_plot import write_fit_plot
from saltus.render.stereo.camera import UNFILTERED, StereoCamera, StereoConfig
from saltus.render.stereo.optics import StereoOptics
from saltus.render.stereo_fit import FitResult, fit_stereo, load_frames
from saltus.wire.messages import DepthFrame

BAG = Path(__file__).resolve().parents[3] / "shared" / "data" / "realsense_d435_640x480.bag"


def recording(
    config: StereoConfig, optics: StereoOptics, scene: Any, count: int
) -> list[DepthFrame]:
    return frames_of(StereoCamera(config, optics), scene, count, np.random.default_rng(6))


def hidden(sigma: float, step: float, **changes: Any) -> StereoConfig:
    noise = replace(UNFILTERED.disparity_noise, sigma=sigma)
    return replace(
        UNFILTERED,
        disparity_noise=noise,
        disparity_step=replace(UNFILTERED.disparity_step, step=step),
        **changes,
    )


def wall_and_step(
    optics: StereoOptics, wall_m: float = 1.6, near_m: float = 0.6, slant: float = 0.4
) -> Any:
    return wall_and_panel(D435I, optics, wall_m, near_m, -0.35, 0.15, slant=slant)


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("baseline", "sigma", "step", "wall_m", "near_m", "slant"),
    [
        (0.050, 0.08, 1 / 32, 1.6, 0.6, 0.4),
        (0.043, 0.06, 1 / 16, 1.8, 0.5, 0.2),
        (0.062, 0.12, 1 / 32, 1.4, 0.7, 0.5),
        (0.055, 0.05, 1 / 64, 2.2, 0.6, 0.0),
    ],
)
def test_hidden_noise_baseline_and_step_are_found_within_10_percent(
    baseline: float, sigma: float, step: float, wall_m: float, near_m: float, slant: float
) -> None:
    optics = StereoOptics.of(D435I, baseline_m=baseline)
    config = hidden(sigma, step)
    found = fit_stereo(
        recording(config, optics, wall_and_step(optics, wall_m, near_m, slant), 60)
    ).parameters
    assert found.baseline_m.value == pytest.approx(baseline, rel=0.1)
    assert found.sigma_px.value == pytest.approx(sigma, rel=0.1)
    assert found.step_px.value == pytest.approx(step, rel=0.1)
    assert found.persistence_s.value == pytest.approx(config.disparity_noise.persistence_s, rel=0.1)
    assert found.correlation_px.value == pytest.approx(config.disparity_noise.correlation, rel=0.1)
    assert found.range_exponent.value == pytest.approx(2.0, abs=0.1)
    assert found.hole_fraction.value == pytest.approx(0.1, abs=0.03)
    assert found.flying_fraction.value == pytest.approx(0.2, abs=0.03)
    assert abs(found.margin_px.value or 0.0) < 1.5
    for estimate in (found.maximum_px, found.reach_m):
        assert not estimate.testable
        assert estimate.note


def test_a_wider_band_is_a_margin_not_a_baseline() -> None:
    optics = StereoOptics.of(D435I)
    config = hidden(0.08, 1 / 32, search_range=replace(UNFILTERED.search_range, margin=-10.0))
    found = fit_stereo(recording(config, optics, wall_and_step(optics), 12)).parameters
    assert found.baseline_m.value == pytest.approx(0.05, rel=0.1)
    assert found.margin_px.value == pytest.approx(-10.0, abs=1.0)


def test_what_a_wall_alone_cannot_show_is_untestable() -> None:
    optics = StereoOptics(
        focal_px=D435I.fx, first_column=172.0
    )  # the middle of the sensor: no band
    found = fit_stereo(
        recording(hidden(0.08, 1 / 32), optics, flat_wall(D435I, 1.5), 20)
    ).parameters
    untestable = {f.name for f in fields(found) if not getattr(found, f.name).testable}
    expected = {
        "baseline_m",
        "range_exponent",
        "margin_px",
        "hole_fraction",
        "flying_fraction",
        "maximum_px",
        "reach_m",
    }
    assert untestable == expected
    assert "one range" in found.range_exponent.note
    assert "baseline" in found.sigma_px.note
    assert found.sigma_px.value == pytest.approx(0.08, rel=0.1)
    for name in untestable:
        assert getattr(found, name).note


def test_near_walls_hide_the_step_behind_the_depth_unit() -> None:
    optics = StereoOptics.of(D435I)
    found = fit_stereo(
        recording(hidden(0.08, 1 / 32), optics, flat_wall(D435I, 0.35), 20)
    ).parameters
    assert not found.step_px.testable
    assert "depth unit" in found.step_px.note


def test_the_part_at_rest_is_used() -> None:
    optics = StereoOptics.of(D435I)
    scene = wall_and_step(optics)
    moving = [
        frame
        for k in range(6)
        for frame in recording(
            hidden(0.08, 1 / 32), optics, wall_and_step(optics, 1.0 + 0.5 * k, 0.4 + 0.1 * k), 1
        )
    ]
    result = fit_stereo(moving + recording(hidden(0.08, 1 / 32), optics, scene, 14))
    assert result.scene.frames == 14


def two_frames() -> list[DepthFrame]:
    optics = StereoOptics.of(D435I)
    return recording(hidden(0.08, 1 / 32), optics, wall_and_step(optics), 2)


def test_two_frames_say_so() -> None:
    found = fit_stereo(two_frames()).parameters
    for name in (
        "sigma_px",
        "step_px",
        "correlation_px",
        "persistence_s",
        "range_exponent",
        "flying_fraction",
    ):
        assert "2 frames" in getattr(found, name).note
    assert found.baseline_m.testable


def test_bad_recordings_are_refused_in_one_line(tmp_path: Path) -> None:
    first, second = two_frames()
    cases = {
        "no depth frames": [],
        "does not match": [first, replace(second, depth=second.depth[:100])],
        "fx": [first, replace(second, fx=300.0)],
        "valid": [replace(first, depth=np.zeros_like(first.depth))],
    }
    for message, frames in cases.items():
        with pytest.raises(RecordingError, match=message) as error:
            fit_stereo(frames)
        assert "\n" not in str(error.value)
    with pytest.raises(RecordingError, match="neither"):
        load_frames(tmp_path / "depth.png")


def written(result: FitResult, folder: Path) -> str:
    return write_fit_plot(result, folder / "fit.html").read_text()


def test_toml_is_a_camera_and_the_plot_says_what_is_untestable(tmp_path: Path) -> None:
    result = fit_stereo(two_frames())
    (tmp_path / "camera.toml").write_text(result.to_toml())
    camera = load_camera(str(tmp_path / "camera.toml"))
    assert camera == result.camera
    config = StereoConfig.of(camera)
    assert config == result.config
    assert config.disparity_noise == UNFILTERED.disparity_noise  # nothing seen, nothing changed
    assert (
        f"# sigma_px         untestable             {result.parameters.sigma_px.note}\n"
        in result.to_toml()
    )
    assert camera.baseline_m == pytest.approx(0.05, rel=0.1)
    assert camera.image == D435I
    assert StereoOptics.behind(camera.image, camera) == result.optics
    page = written(result, tmp_path)
    assert page.count("untestable") == sum(
        not getattr(result.parameters, f.name).testable for f in fields(result.parameters)
    )
    assert "Plotly" in page


def test_a_real_recording(tmp_path: Path) -> None:
    if not BAG.parent.is_dir():
        pytest.skip(f"no real recordings beside the checkout: {BAG.parent} is absent")
    result = fit_stereo(load_frames(BAG))
    found = result.parameters
    assert result.scene.frames == 2
    # Two frames: holes at edges widen shadows
    assert found.baseline_m.value == pytest.approx(0.050, rel=0.2)
    assert "few frames" in found.baseline_m.note
    assert -14.0 < (found.margin_px.value or 0.0) < -8.0
    assert not found.sigma_px.testable
    assert not found.step_px.testable
    assert written(result, tmp_path)
