"""A process is killed in the middle of a run: the others say so, the robot lands and stands, the process comes back."""

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from saltus.config import RunConfig, TerrainConfig
from saltus.errors import RecordingError, StackError
from saltus.recordings.recording import read_recording
from saltus.runtime.faults import PRODUCT, judge, kill_during_run
from saltus.wire.messages import ControllerMode, RobotState

CONFIG = RunConfig(terrain=TerrainConfig(terrain="flat"), pace="realtime", planner="scripted")


@pytest.mark.parametrize("process", PRODUCT)
def test_a_killed_process_is_noticed_and_the_robot_stands(process: str, speed: float, tmp_path: Path) -> None:
    after_s = {"render": 0.7, "heightmap": 0.9, "policy": 1.1}[process]
    recording = kill_during_run(replace(CONFIG, speed=speed), tmp_path, process, after_s)
    result = judge(recording, process, after_s)
    assert result.told_ms <= 110.0
    assert result.back_s <= 2.0
    assert result.mode == ControllerMode.STOPPED
    assert result.upright


def test_a_killed_controller_ends_the_run_and_leaves_a_recording(speed: float, tmp_path: Path) -> None:
    with pytest.raises(StackError, match=r"controller died \(.*SIGKILL"):
        kill_during_run(replace(CONFIG, speed=speed), tmp_path, "controller", 0.5)
    recording = read_recording(tmp_path / "recording.mcap")
    assert recording.lost == []
    assert sum(1 for _ in recording.messages("controller/state")) > 100


def steps_recorded(path: Path) -> int:
    try:
        return sum(1 for _ in read_recording(path).messages("controller/state"))
    except RecordingError:  # not there yet, or not a whole message
        return 0


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, -signal.SIGTERM), (signal.SIGHUP, -signal.SIGHUP)]
)
def test_a_demo_that_is_ended_lands_closes_the_recording_and_says_by_what(
    number: signal.Signals, code: int, speed: float, tmp_path: Path
) -> None:
    command = [
        sys.executable,
        "-m",
        "saltus.cli.main",
        "demo",
        "--terrain",
        "flat",
        "--no-video",
        "--out",
        str(tmp_path),
    ]
    demo = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    deadline_s = time.monotonic() + 30.0 / speed
    while steps_recorded(tmp_path / "recording.mcap") < 50 and time.monotonic() < deadline_s:
        time.sleep(0.1)
    demo.send_signal(number)
    assert demo.wait(timeout=20.0 / speed) == code
    recording = read_recording(tmp_path / "recording.mcap")
    assert recording.complete
    modes = [state.mode for state in recording.of(RobotState)]
    assert modes[-1] in (ControllerMode.STAND, ControllerMode.STOPPED)
