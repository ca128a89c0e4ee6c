"""Images that show the ground of another time than they say are late by just that."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from saltus.api import robot_states
from saltus.cli.camera_checks import camera_checks
from saltus.depth import Intrinsics, depth_frame
from saltus.depth_camera import SHIPPED
from saltus.errors import RecordingError
from saltus.recordings import recording as recordings
from saltus.render import calibrate
from saltus.render.calibrate import CameraPlace
from saltus.render.camera import ray_directions
from saltus.render.lateness import measure_lateness
from saltus.robots.loading import load_robot
from saltus.robots.mount import Mount
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix
from saltus.wire.messages import ControllerMode, DepthFrame, RobotState

ROBOT = load_robot("go2")
VIEW = Intrinsics(width=80, height=240, fx=211.39, fy=211.39, cx=40.0, cy=120.0)
POSITION = np.asarray(ROBOT.camera_position)
PLACE = CameraPlace(pitch=ROBOT.camera_pitch, roll=0.0, height=float(POSITION[2]))
SECONDS, FIRST_S, STANDS_S = 3.5, 0.3, 1.0


def moving(
    late_s: float, seed: int, *, swing: float = 0.08
) -> tuple[list[DepthFrame], list[RobotState]]:
    """A robot that pitches and rolls over level ground, and images whose times are wrong."""
    rng = np.random.default_rng(seed)
    phases, rates = rng.uniform(0.0, 6.0, 2), rng.uniform(4.0, 12.0, 2)

    def lean(time_s: np.ndarray) -> np.ndarray:
        grown = np.clip(2.0 * (time_s - STANDS_S), 0.0, 1.0)
        turned = grown * swing * np.sin(phases[:, None] + rates[:, None] * time_s)
        return quaternion_from_roll_pitch_yaw(0.3 * turned[0], turned[1], 0.0 * time_s)

    time_s = np.arange(0.0, SECONDS, 0.01)
    rate = np.where(
        time_s > STANDS_S,
        swing * rates[:, None] * np.cos(phases[:, None] + rates[:, None] * time_s),
        0.0,
    )
    states = robot_states(
        time_s, quaternion_base_in_world=lean(time_s),
        angular_velocity_base=np.stack([0.3 * rate[0], rate[1], 0.0 * time_s], axis=-1),
        joint_position=np.tile(ROBOT.stand_pose, (len(time_s), 1)),
        velocity_base_in_world=np.zeros((len(time_s), 3)),
        base_height=np.full(len(time_s), ROBOT.stand_height), leg_trusted=np.ones((len(time_s), 4)),
    )  # fmt: skip
    states = [
        replace(state, mode=ControllerMode.STAND if at < STANDS_S else ControllerMode.RUN)
        for at, state in zip(time_s, states, strict=True)
    ]
    rays = ray_directions(VIEW) @ Mount(position=POSITION, pitch=PLACE.pitch).rotation.T
    frames = []
    taken_s = np.arange(FIRST_S, SECONDS - FIRST_S, 0.02)
    for number, quaternion in enumerate(lean(taken_s)):
        up = rotation_matrix(quaternion)[2]
        lifted = 0.02 * rng.standard_normal() if taken_s[number] > STANDS_S else 0.0  # in mid-air
        above = up @ POSITION + ROBOT.stand_height + lifted
        depth = above / np.maximum(-(rays @ up), 0.02)
        depth += 0.004 * depth**2 * rng.standard_normal(depth.shape)
        millimetres = (1e3 * depth).clip(0, 65535).round().astype(np.uint16)
        time_ns = round(1e9 * (taken_s[number] + late_s))
        frames.append(depth_frame(VIEW, millimetres, time_ns=time_ns, frame_id=number))
    return frames, states


@pytest.mark.sample(4)
@pytest.mark.parametrize("seed", range(8))
def test_lateness_is_found_wherever_it_lies(seed: int) -> None:
    late_s = float(np.random.default_rng([seed, 1]).uniform(-0.04, 0.15))
    found = measure_lateness(*moving(late_s, seed), ROBOT, PLACE)
    assert found.late_s == pytest.approx(late_s, abs=0.003)
    assert found.half_width_90 < 0.005


@pytest.mark.sample(5)
@pytest.mark.parametrize(
    ("changed", "late_s", "refused"),
    [
        ({}, 0.0, set()), ({}, 0.004, set()), ({}, 0.05, {"lateness"}), ({}, -0.03, {"lateness"}),
        ({"camera_pitch": PLACE.pitch + 0.015}, 0.0, set()),
        ({"camera_pitch": PLACE.pitch + 0.04}, 0.0, {"camera"}),
        ({"camera_roll": -0.04}, 0.0, {"camera"}),
        ({"camera_position": POSITION + np.array([0.0, 0.0, 0.016])}, 0.03, {"camera", "lateness"}),
    ],
)  # fmt: skip
def test_a_preflight_refuses_a_camera_that_is_off_or_late(
    changed: dict[str, Any], late_s: float, refused: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    frames, states = moving(late_s, 3)
    recording = SimpleNamespace(
        of=lambda kind: frames if kind is DepthFrame else states,
        robot=replace(ROBOT, **changed), camera=SHIPPED["d435i"],
    )  # fmt: skip
    for room in (calibrate, recordings):
        monkeypatch.setattr(room, "read_recording", lambda _: recording)
    checks = camera_checks(Path("a.mcap"))
    assert {check.name for check in checks if not check.passed} == refused
    assert len(checks) == 2


def test_a_preflight_says_why_a_recording_tells_nothing_of_a_camera(tmp_path: Path) -> None:
    for check in camera_checks(tmp_path / "none.mcap"):
        assert not check.passed
        assert "none.mcap" in check.found or check.found == "not looked for"


def test_a_robot_that_hardly_turns_tells_nothing() -> None:
    with pytest.raises(RecordingError, match="in which the trunk turns"):
        measure_lateness(*moving(0.05, 0, swing=0.005), ROBOT, PLACE)
    frames, states = moving(0.05, 0)
    with pytest.raises(RecordingError, match="0 images"):
        measure_lateness([], states, ROBOT, PLACE)
    with pytest.raises(RecordingError, match="0 images"):
        measure_lateness(frames, [], ROBOT, PLACE)
    blank = [replace(frame, depth=0 * frame.depth) for frame in frames]
    with pytest.raises(RecordingError, match="0 images"):
        measure_lateness(blank, states, ROBOT, PLACE)
