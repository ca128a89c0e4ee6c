"""However a run ends, the robot lands and stands,
what was recorded is readable, and who started it learns of it.
"""

import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from benchmarks._judgement import is_upright
from benchmarks._kills import witness
from saltus.recordings.recording import Recording, read_recording
from saltus.recordings.repair import repair_recording
from saltus.recordings.timing import rates_and_ages, run_digest
from saltus.wire.messages import ControllerMode, RobotState

AFTER_S = 0.8
ROOM = 900_000  # bytes: a second or two of a run
ENDED_S = 10.0


def up(
    run_dir: Path, *flags: str, limit: Callable[[], None] | None = None
) -> "subprocess.Popen[str]":
    """A run on flat ground that another process hosts."""
    course = ("--terrain", "flat", "--planner", "scripted", "--camera", "ideal")
    return subprocess.Popen(
        [sys.executable, "-m", "saltus.cli.main", "up", *course, *flags, "--out", str(run_dir)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=limit,
    )


def stands(seen: Recording) -> bool:
    modes = [state.mode for state in seen.of(RobotState)]
    assert ControllerMode.RUN in modes
    return modes[-1] in (ControllerMode.STAND, ControllerMode.STOPPED) and is_upright(seen, steps=5)


@pytest.mark.slow
def test_a_full_disk_lands_the_robot_and_is_said_in_one_line(tmp_path: Path) -> None:
    """The disk is full for files of more than a size:
    so the system refuses to write, without any right to a disk.
    """
    limit = (ROOM, resource.getrlimit(resource.RLIMIT_FSIZE)[1])
    process = up(
        tmp_path / "run",
        "--pace",
        "lockstep",
        limit=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, limit),
    )
    seen = witness(process, tmp_path / "run", tmp_path / "seen.mcap", float("inf"), lambda: None)
    _, told = process.communicate()
    path = tmp_path / "run" / "recording.mcap"
    assert process.returncode == 2
    assert told == f"saltus: cannot write {path}: File too large\n"
    # In lockstep a landing passes faster than a witness can hear all of it
    assert ControllerMode.LANDING in {state.mode for state in seen.of(RobotState)}
    recording = repair_recording(path, tmp_path / "repaired.mcap")
    assert not recording.complete
    assert len(recording.of(RobotState)) > 100
    assert len(read_recording(tmp_path / "repaired.mcap").of(RobotState)) == len(
        recording.of(RobotState)
    )


@pytest.mark.slow
def test_processes_of_a_killed_supervisor_land_the_robot_and_end(
    speed: float, tmp_path: Path
) -> None:
    process = up(tmp_path / "run", "--speed", str(speed))
    children: list[psutil.Process] = []

    def kill() -> None:
        children.extend(psutil.Process(process.pid).children(recursive=True))
        process.send_signal(signal.SIGKILL)

    seen = witness(process, tmp_path / "run", tmp_path / "seen.mcap", AFTER_S, kill)
    process.communicate()
    assert stands(seen)
    assert len(children) >= 4
    _, alive = psutil.wait_procs(children, timeout=ENDED_S / speed)
    assert not alive, alive
    recording = read_recording(tmp_path / "run" / "recording.mcap")
    assert recording.of(RobotState)[-1].time_ns > seen.of(RobotState)[-1].time_ns - 5e9


@pytest.mark.slow
def test_a_run_in_lockstep_that_is_interrupted_counts_its_messages_on(tmp_path: Path) -> None:
    """The states of the landing are counted on from those before:
    readers drop what is counted anew.
    """
    process = up(tmp_path / "run", "--pace", "lockstep")
    seen = witness(
        process, tmp_path / "run", tmp_path / "seen.mcap", AFTER_S,
        lambda: process.send_signal(signal.SIGINT),
    )  # fmt: skip
    told, _ = process.communicate()
    assert ControllerMode.RUN in {state.mode for state in seen.of(RobotState)}
    assert "lacks" not in told, told
    recording = read_recording(tmp_path / "run" / "recording.mcap")
    assert {row.lost for row in rates_and_ages(recording).values()} == {0}
    assert run_digest(recording)
