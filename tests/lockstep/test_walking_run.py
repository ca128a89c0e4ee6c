"""A policy that commands joints and one that jumps in the four processes.

They obey an operator, and the run repeats to the bit.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lockstep_run import check_repeats, recorded_run
from samples import ROBOT
from walking_policies import put_policy

from saltus.cli import video
from saltus.config import RunConfig, TerrainConfig
from saltus.grid import SCAN_AND_LINE, WALKING_GRID, HeightGrid
from saltus.policy.joints.footing import BEARS_NS, LONGEST_NS
from saltus.policy.joints.walker import STOP_NS
from saltus.recordings.recording import Recording, read_recording
from saltus.recordings.timing import run_digest
from saltus.runtime.stack import Stack
from saltus.wire.messages import (
    CommandMode,
    ControllerMode,
    DriveCommand,
    Event,
    GroundTruth,
    Heightmap,
    JointPlan,
    MotionPlan,
    RobotState,
)

JUMPS_S, WALKS_S, ENDS_S = 1.6, 2.8, 4.4
LENGTH_S = 5.8


def walks_jumps_and_walks_until_it_ends(
    state: RobotState, walks_s: float = WALKS_S
) -> DriveCommand | None:
    """An operator who says nothing any more after a while."""
    if state.time_ns > ENDS_S * 1e9:
        return None
    jumps = JUMPS_S * 1e9 < state.time_ns <= walks_s * 1e9
    return DriveCommand(
        time_ns=state.time_ns,
        step=state.step,
        mode=CommandMode.JUMP if jumps else CommandMode.WALK,
        velocity_x=0.0,
        velocity_y=0.0,
        yaw_rate=0.0,
    )


def config_in(folder: Path, length_s: float) -> RunConfig:
    """A run on level ground with a policy that stands in its pose; nobody looks at the ground."""
    return RunConfig(
        robot="go1",
        grid=WALKING_GRID,
        terrain=TerrainConfig(terrain="flat"),
        camera="ideal",
        heights="true",
        planner="walking",
        policy_model=str(put_policy(folder / "walk.onnx")),
        time_limit_s=length_s,
    )


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("run")
    return recorded_run(
        folder, config_in(folder, LENGTH_S), driver=walks_jumps_and_walks_until_it_ends
    )


def test_it_walks_and_jumps_as_it_is_told_to_and_stands_in_between_and_when_commands_end(
    recording: Recording,
) -> None:
    states = list(recording.of(RobotState))
    begun = [
        (state.mode.name, 1e-9 * state.time_ns)
        for state, before in zip(states, [None, *states], strict=False)
        if before is None or state.mode != before.mode
    ]
    order = ["STAND", "WALK", "STAND", "RUN", "LANDING", "STAND", "WALK", "STAND"]
    assert [mode for mode, _ in begun] == order
    walks, stands, jumps, lands, _, again, ends = (time_s for _, time_s in begun[1:])
    assert (walks, lands) == pytest.approx((1.01, WALKS_S + 0.01), abs=0.011)
    # It is slow already; where commands end, the last one holds for 0.5 s
    least, most = 1e-9 * (STOP_NS[0] + BEARS_NS), 1e-9 * (STOP_NS[0] + LONGEST_NS)
    for told, stood in ((JUMPS_S, stands), (ENDS_S + 0.5, ends)):
        assert least - 0.02 < stood - told < most + 0.02
    assert jumps - stands < 0.05
    assert again - lands < 1.2
    height = {truth.step: truth.position_base_in_world[2] for truth in recording.of(GroundTruth)}
    walked = [s.step for s in states if s.mode == ControllerMode.WALK and s.time_ns < JUMPS_S * 1e9]
    assert height[walked[-1]] - height[walked[0]] > 0.01
    assert not any(event.code == "plan_lost" for event in recording.of(Event))


def test_each_state_gets_one_plan_of_whoever_moves_the_robot(recording: Recording) -> None:
    walks, jumps = list(recording.of(JointPlan)), list(recording.of(MotionPlan))
    steps = [plan.step for plan in (*walks, *jumps)]
    assert len(set(steps)) == len(steps) >= LENGTH_S * 100
    assert {bool(plan.reason) == (plan.status != 1) for plan in (*walks, *jumps)} == {True}
    assert next(iter(recording.of(Heightmap))).height.shape == (SCAN_AND_LINE.size,)


def test_its_video_shows_heights_on_the_grid_of_the_run(
    recording: Recording, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    drawn: list[tuple[HeightGrid, tuple[int, ...]]] = []

    def render(*arguments: Any, **_: Any) -> Iterator[Any]:
        drawn.append((arguments[5], arguments[6].shape))
        return iter(())

    monkeypatch.setattr(video, "render_run", render)
    monkeypatch.setattr(video, "encode", lambda *_, **__: 0)
    video.write_run_video(recording, tmp_path / "run.mp4")
    steps = len(list(recording.of(GroundTruth)))
    assert drawn == [(recording.grid, (steps, SCAN_AND_LINE.size))]


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["policy", "controller", "heightmap", "render"])
def test_every_process_repeats_to_the_bit(recording: Recording, name: str) -> None:
    check_repeats(recording, name, int(LENGTH_S * 50))


def test_the_estimate_holds_while_no_schedule_says_which_feet_stand(recording: Recording) -> None:
    truths = {truth.step: truth for truth in recording.of(GroundTruth)}
    walked = [s for s in recording.of(RobotState) if s.mode == ControllerMode.WALK]
    errors = [s.velocity_base_in_world - truths[s.step].velocity_base_in_world for s in walked]
    assert np.sqrt(np.mean(np.square(errors), axis=0)).max() < 0.05
    bear = np.array([truths[state.step].foot_force > 0.25 * 9.81 * ROBOT.mass for state in walked])
    assert np.mean(np.array([state.leg_trusted for state in walked])[bear]) > 0.95


def test_the_estimate_holds_in_a_landing(recording: Recording) -> None:
    """By the schedule alone, feet that hung in the air said 0.7 m/s too little of a fall."""
    truths = {truth.step: truth for truth in recording.of(GroundTruth)}
    lands = [s for s in recording.of(RobotState) if s.mode == ControllerMode.LANDING]
    errors = [s.velocity_base_in_world - truths[s.step].velocity_base_in_world for s in lands]
    assert len(lands) > 30
    assert np.abs(errors).max() < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("walks_s", [2.6, 3.0])
def test_the_estimate_holds_in_a_landing_from_other_moments_of_the_gait(
    walks_s: float, tmp_path: Path
) -> None:
    driver = partial(walks_jumps_and_walks_until_it_ends, walks_s=walks_s)
    test_the_estimate_holds_in_a_landing(
        recorded_run(tmp_path, config_in(tmp_path, walks_s + 1.0), driver=driver)
    )


@pytest.mark.slow
def test_five_processes_over_zenoh_say_what_threads_in_one_process_say(tmp_path: Path) -> None:
    """A whole stack with a script of commands:
    whoever carries the messages, the run is the same.
    """
    script = tmp_path / "script.csv"
    script.write_text("time_s,mode,ahead_mps\n0,walk,0.3\n1.7,stand\n", encoding="utf-8")
    config = RunConfig(
        robot="go1",
        grid=WALKING_GRID,
        terrain=TerrainConfig(terrain="flat"),
        planner="walking",
        policy_model=str(put_policy(tmp_path / "walk.onnx")),
        commands=str(script),
        time_limit_s=2.4,
    )
    (tmp_path / "threads").mkdir()
    threads = recorded_run(tmp_path / "threads", config)
    with Stack(config, tmp_path / "stack") as stack:
        assert stack.wait(600.0)
    processes = read_recording(stack.recording)
    assert {state.mode for state in processes.of(RobotState)} >= {ControllerMode.WALK}
    assert {command.mode for command in processes.of(DriveCommand)} == {
        CommandMode.WALK, CommandMode.STAND,
    }  # fmt: skip
    assert run_digest(processes) == run_digest(threads)
