"""Where a camera sits: found wherever it is, with its noise and a leg in view, on level ground.

Else refused.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lockstep_run import recorded_run
from report_pages import opens_without_a_network

from saltus.api import robot_states
from saltus.cli.main import main
from saltus.config import RunConfig, TerrainConfig
from saltus.depth import BASELINE_M, Intrinsics, depth_frame
from saltus.depth_camera import SHIPPED, load_camera
from saltus.errors import RecordingError
from saltus.render.calibrate import (
    FEWEST_FRAMES,
    SIGMA_PX,
    CameraCalibration,
    CameraPlace,
    fit_place,
    standing_pairs,
)
from saltus.render.camera import ray_directions
from saltus.robots.loading import load_robot
from saltus.robots.mount import Mount
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix
from saltus.wire.messages import ControllerMode, DepthFrame, RobotState

ROBOT, CAMERA = load_robot("go1"), SHIPPED["d435i"]
VIEW = Intrinsics(width=80, height=240, fx=211.39, fy=211.39, cx=40.0, cy=120.0)
FRAMES, MS = 50, 1_000_000
Pairs = list[tuple[DepthFrame, RobotState]]


def standing(
    place: CameraPlace,
    seed: int = 0,
    *,
    noise: float = SIGMA_PX,
    step_ahead_m: float | None = None,
    frames: int = FRAMES,
) -> Pairs:
    """Images of level ground, of a robot that leans this way and that.

    A leg covers a corner of each.
    """
    rng, pairs = np.random.default_rng(seed), []
    time_s = 0.02 * np.arange(frames)
    lean = rng.uniform(-0.03, 0.03, (2, frames))
    quaternion = quaternion_from_roll_pitch_yaw(lean[0], lean[1], np.full(frames, 0.4))
    base_height = ROBOT.stand_height + rng.uniform(-0.02, 0.02, frames)
    states = robot_states(
        time_s, quaternion_base_in_world=quaternion, angular_velocity_base=np.zeros((frames, 3)),
        joint_position=np.tile(ROBOT.stand_pose, (frames, 1)),
        velocity_base_in_world=np.zeros((frames, 3)),
        base_height=base_height, leg_trusted=np.ones((frames, 4)),
    )  # fmt: skip
    c, s = np.cos(place.roll), np.sin(place.roll)
    position = np.array([*ROBOT.camera_position[:2], place.height])
    rays = ray_directions(VIEW) @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    rays = rays @ Mount(position=position, pitch=place.pitch).rotation.T
    for i, state in enumerate(states):
        turn = rotation_matrix(np.asarray(state.quaternion_base_in_world))
        down, above = -(rays @ turn.T)[..., 2], (turn @ position)[2] + state.base_height
        ahead = rays @ np.array([1.0, 0.0, 0.0])
        depth = np.where(down > 0.02, above / np.maximum(down, 0.02), np.inf)
        if step_ahead_m is not None:  # a wall from there on
            depth = np.minimum(depth, step_ahead_m / np.maximum(ahead, 1e-3))
        near = np.minimum(depth, 10.0)
        depth = depth + noise * near**2 / (VIEW.fx * BASELINE_M) * rng.standard_normal(depth.shape)
        depth[200:, :25] = 0.3
        millimetres = (
            np.where(near < 8.0, 1e3 * depth, 65535.0).clip(0, 65535).round().astype(np.uint16)
        )
        millimetres[rng.uniform(size=depth.shape) < 0.05] = 0
        pairs.append(
            (
                depth_frame(VIEW, millimetres, time_ns=state.time_ns, frame_id=i),
                replace(state, mode=0),
            )
        )
    return pairs


def places(count: int) -> list[CameraPlace]:
    draws = np.random.default_rng(7).uniform(-1.0, 1.0, (count, 3)) * (
        np.deg2rad(5.0),
        np.deg2rad(2.0),
        0.03,
    )
    claimed = np.array([ROBOT.camera_pitch, 0.0, ROBOT.camera_position[2]])
    return [CameraPlace(pitch=p, roll=r, height=z) for p, r, z in (claimed + draws).tolist()]


def fitted(pairs: Pairs) -> CameraCalibration:
    return fit_place(pairs, ROBOT, CAMERA)


@pytest.mark.sample(3)
@pytest.mark.parametrize("true", places(12))
def test_the_place_is_found_wherever_it_is(true: CameraPlace) -> None:
    found = fitted(standing(true))
    assert abs(found.found.pitch - true.pitch) < np.deg2rad(0.05)
    assert abs(found.found.roll - true.roll) < np.deg2rad(0.2)
    assert abs(found.found.height - true.height) < 0.001
    assert found.camera.camera_pitch == found.found.pitch
    assert found.camera.camera_position == (*ROBOT.camera_position[:2], found.found.height)
    assert found.on_ground > 0.8


def test_intervals_hold_the_truth_as_often_as_they_say_and_grow_with_the_noise() -> None:
    true, inside, widths = places(1)[0], [], []
    for seed in range(20):
        found = fitted(standing(true, seed, frames=FEWEST_FRAMES))
        off = np.abs(
            [getattr(found.found, name) - getattr(true, name) for name in ("pitch", "height")]
        )
        half = np.array([found.half_width_90.pitch, found.half_width_90.height])
        inside.append(off <= half)
        widths.append(half)
    # Of 20, each with 90 %: less has a probability of 0.2 %
    assert np.sum(inside, axis=0).min() >= 13
    noisy = fitted(standing(true, noise=5.0 * SIGMA_PX, frames=FEWEST_FRAMES)).half_width_90
    assert noisy.pitch > 2.0 * np.median(widths, axis=0)[0]


def test_what_is_no_level_ground_is_refused() -> None:
    with pytest.raises(RecordingError, match="stand on level ground with nothing ahead"):
        fitted(standing(places(1)[0], step_ahead_m=0.6))


def test_only_images_of_a_robot_that_stands_count() -> None:
    pairs = standing(places(1)[0])
    frames, states = [frame for frame, _ in pairs], [state for _, state in pairs]
    assert len(standing_pairs(frames, states)) == FRAMES
    runs = [replace(state, mode=ControllerMode.RUN) for state in states[10:]]
    assert len(standing_pairs(frames, [*states[:10], *runs])) == 10
    lifted = [replace(state, leg_trusted=np.array([True, True, True, False])) for state in states]
    assert standing_pairs(frames, lifted) == []
    unknown = [
        replace(state, leg_trusted=np.zeros(4, bool), mode=ControllerMode.RUN) for state in states
    ]
    assert len(standing_pairs(frames, unknown)) == FRAMES  # at rest, and nobody says more
    for moves in (
        {"velocity_base_in_world": np.array([0.0, 0.0, 0.1])},
        {"angular_velocity_base": np.full(3, 0.1)},
    ):
        assert standing_pairs(frames, [replace(state, **moves) for state in unknown]) == []
    assert standing_pairs(frames, []) == []
    late = [replace(state, time_ns=state.time_ns + 500 * MS) for state in states]
    assert len(standing_pairs(frames, late)) == FRAMES - 25


@pytest.mark.slow
def test_a_recording_gives_a_camera_that_commands_take(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The robot of a run stands for a second; its camera sits where it claims."""
    config = RunConfig(
        robot="go1", grid="line", terrain=TerrainConfig(terrain="flat"), planner="scripted",
        camera="d435i", time_limit_s=1.0,
    )  # fmt: skip
    recording, out = str(recorded_run(tmp_path, config).path), tmp_path / "found"
    assert main(["render", "calibrate", recording, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"{out}: camera.toml, calibration.html" in said
    camera = load_camera(str(out / "camera.toml"))
    assert camera.camera_pitch == pytest.approx(ROBOT.camera_pitch, abs=np.deg2rad(0.3))
    assert camera.camera_position == pytest.approx(tuple(ROBOT.camera_position), abs=0.005)
    assert "as claimed" in (out / "calibration.html").read_text()
    opens_without_a_network(out / "calibration.html")


def test_a_recording_without_a_standing_robot_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from recorded import run_samples, write

    path = write(tmp_path / "recording.mcap", list(run_samples())).path
    assert main(["render", "calibrate", str(path), "--out", str(tmp_path / "out")]) == 2
    assert f"it must stand for at least {FEWEST_FRAMES} of them" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
