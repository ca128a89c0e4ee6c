"""The whole stack: it repeats to the bit in lockstep,
leaves readable files behind, can be replayed and ended.
"""

import contextlib
import ctypes
import io
import json
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from report_pages import opens_without_a_network

from saltus.cli.main import main
from saltus.config import RunConfig, load_config
from saltus.recordings.recording import read_recording
from saltus.wire.messages import ControllerMode, RobotState

TIME_LIMIT_S = "2.5"
FLAGS = [
    "demo",
    "--terrain",
    "flat",
    "--time-limit-s",
    TIME_LIMIT_S,
    "--no-video",
    "--json",
    "--camera",
    "ideal",
]
REPEATED = ("success", "distance_m", "time_s", "mean_speed_mps", "heightmap_mae_m", "digest")
PATIENCE_S = 60.0
BEGIN_STEPS = 20
STANDS_STILL_S = 0.6
HELD_S = 0.5


def demo(*flags: str) -> dict[str, Any]:
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        main([*FLAGS, *flags])
    table: dict[str, Any] = json.loads(printed.getvalue().splitlines()[-1])
    return table


def hold_one_after_another(run: psutil.Process) -> None:
    """Lets each process of a run stand still in turn,
    until its report is all that is left to do.
    """
    while not (processes := run.children()) and run.status() != psutil.STATUS_ZOMBIE:
        time.sleep(0.02)
    while processes:
        for process in (run, *processes):
            with contextlib.suppress(psutil.NoSuchProcess):
                process.suspend()
                try:
                    time.sleep(STANDS_STILL_S)
                finally:
                    process.resume()
            time.sleep(STANDS_STILL_S)
        processes = run.children()


@contextlib.contextmanager
def nobody_else_runs() -> Iterator[None]:
    """Threads of this process wait every other half second, as for a collection of much garbage."""
    # Keeps Python's lock where others give it up
    over, holding = (
        threading.Event(),
        ctypes.PyDLL(None),
    )

    def hold() -> None:
        while not over.wait(HELD_S):
            holding.usleep(round(1e6 * HELD_S))

    thread = threading.Thread(target=hold)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Folder and table of a run whose recorder hears nothing for half a second, again and again."""
    folder = tmp_path_factory.mktemp("run")
    with nobody_else_runs():
        return folder, demo("--seed", "3", "--out", str(folder))


def begin(run: Path) -> list[bytes]:
    """The truth of the first steps of a run."""
    truths = read_recording(run / "recording.mcap").payloads("plant/truth")
    return [payload for _, _, payload in truths][:BEGIN_STEPS]


@pytest.mark.slow
def test_two_lockstep_runs_of_a_seed_are_equal_and_another_seed_differs(
    first: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    """Also where the processes of one stand still for longer than a link of real time bears,
    again and again.
    """
    folder, table = first
    command = [
        sys.executable,
        "-m",
        "saltus.cli.main",
        *FLAGS,
        "--seed",
        "3",
        "--out",
        str(tmp_path / "second"),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as run:
        hold_one_after_another(psutil.Process(run.pid))
        second = json.loads(run.communicate()[0].splitlines()[-1])
    shorter = ["0.3" if word == TIME_LIMIT_S else word for word in FLAGS]
    main([*shorter, "--seed", "4", "--out", str(tmp_path / "other")])  # its begin tells
    assert [table[name] for name in REPEATED] == [second[name] for name in REPEATED]
    assert begin(folder) == begin(tmp_path / "second") != begin(tmp_path / "other")
    assert len(begin(folder)) == len(begin(tmp_path / "other")) == BEGIN_STEPS


def test_a_run_goes_ahead_and_every_message_comes_at_its_rate(
    first: tuple[Path, dict[str, Any]],
) -> None:
    folder, table = first
    assert load_config(RunConfig, folder / "run.toml").planner == "learned"
    assert table["distance_m"] > 1.0  # 1 s of standing, then at more than 1 m/s
    assert table["rejected"] == {}
    rates = {
        "camera/depth": 50,
        "controller/state": 100,
        "heightmap/heightmap": 100,
        "policy/plan": 100,
    }
    assert {topic: pytest.approx(rate, rel=0.02) for topic, rate in rates.items()} == {
        topic: table["rates_hz"][topic] for topic in rates
    }
    # Late by 60 ms at most, held for 20, 10 a step
    assert table["age_ms"]["camera/depth"]["p99"] <= 50 + 20 + 10 + 10


def test_recording_and_report_are_there_and_whole(first: tuple[Path, dict[str, Any]]) -> None:
    folder, _ = first
    recording = read_recording(folder / "recording.mcap")
    assert recording.complete
    assert recording.lost == []
    steps = [state.step for state in recording.of(RobotState)]
    assert steps == list(range(len(steps)))
    report = (folder / "report.html").read_text()
    assert "<html" in report
    opens_without_a_network(folder / "report.html")


@pytest.mark.slow
def test_replay_of_a_lockstep_run_gives_the_same_messages(
    first: tuple[Path, dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    """Those of tests/lockstep/test_process_replay.py were recorded within one process;
    this is the stack's.
    """
    folder, _ = first
    for process in ("camera", "planner", "controller"):
        assert main(["replay", str(folder / "recording.mcap"), "--process", process]) == 0
    assert main(["replay", str(folder / "recording.mcap"), "--json"]) == 0
    table = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert table["messages"]["heightmap/heightmap"]["equal"] > 200
    assert table["first_difference"] is None
    assert table["mae_replayed_m"] == table["mae_recorded_m"]


@pytest.mark.slow
def test_up_says_how_it_went(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It crosses on the images of a stereo camera by pyrender.

    By Embree it does in test_feed_networks.py.
    """
    up = [
        "up",
        "--pace",
        "lockstep",
        "--terrain",
        "gap",
        "--camera",
        "d435i",
        "--renderer",
        "pyrender",
    ]
    assert main([*up, "--out", str(tmp_path)]) == 0
    joined, verdict, recording = capsys.readouterr().out.splitlines()
    assert str(tmp_path / "client.json5") in joined
    assert verdict.startswith("crossed gap: 3.")
    assert recording == f"recording {tmp_path / 'recording.mcap'}"


@contextlib.contextmanager
def running(folder: Path, *command: str) -> Iterator[subprocess.Popen[str]]:
    """A command that has recorded some of its run."""
    saltus = [
        sys.executable,
        "-P",
        "-m",
        "saltus.cli.main",
        *command,
        "--terrain",
        "flat",
        "--out",
        str(folder),
    ]
    with subprocess.Popen(
        saltus, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        recording, deadline_s = folder / "recording.mcap", time.monotonic() + PATIENCE_S
        while not recording.exists() or recording.stat().st_size < 400_000:
            assert time.monotonic() < deadline_s, "there is no run"
            time.sleep(0.05)
        yield process


def check_landed(folder: Path) -> None:
    """The recording is whole, and the robot stands at its end."""
    recording = read_recording(folder / "recording.mcap")
    assert recording.complete
    assert recording.of(RobotState)[-1].mode in (ControllerMode.STAND, ControllerMode.STOPPED)


@pytest.mark.slow
def test_a_demo_that_is_ended_lands_closes_the_recording_and_says_by_what(tmp_path: Path) -> None:
    """SIGTERM ends a demo here, SIGINT below.

    Tests/saltus/test_signals.py has them all.
    """
    with running(tmp_path, "demo", "--no-video") as demo:
        demo.send_signal(signal.SIGTERM)
        assert demo.wait(PATIENCE_S) == -signal.SIGTERM
    check_landed(tmp_path)


@pytest.mark.slow
def test_up_that_is_interrupted_lands_and_says_how_far_it_came(tmp_path: Path) -> None:
    with running(tmp_path, "up", "--pace", "lockstep") as up:
        up.send_signal(signal.SIGINT)
        assert up.stdout is not None
        begun, verdict, _ = up.stdout
        assert up.wait(PATIENCE_S) == 130
    check_landed(tmp_path)
    assert "Ctrl-C ends it" in begun
    assert re.match(r"did not cross \(the run was cut off.*\) flat: [0-9]\.\d\d m", verdict)
