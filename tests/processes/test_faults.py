"""A process is killed in the middle of a run: the others say so, the robot lands and stands, the process comes back."""

from dataclasses import replace
from pathlib import Path

import pytest

from saltus.config import RunConfig, TerrainConfig
from saltus.errors import StackError
from saltus.recordings.recording import read_recording
from saltus.runtime.faults import PRODUCT, judge, kill_during_run
from saltus.wire.messages import ControllerMode

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
