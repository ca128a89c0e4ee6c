"""Runs that are watched in a real browser: one that is started,
disturbed and stopped on the page, and a demo.
"""

import os
import signal
from pathlib import Path

import numpy as np
import psutil
import pytest
from browser import Tab, browser
from page import page_of

from saltus.recordings.recording import read_recording
from saltus.wire.messages import ControllerMode, Event, GroundTruth, RobotState

WIDTH, HEIGHT = 1000, 480
GROUND = slice(200, None), slice(310, 590)
"""Rows and columns of a picture between the panels, below what the browser says of its speed."""
PATIENCE_S = 60.0
# A page has low priority: beside a busy worker it stands still
pytestmark = [pytest.mark.realtime, pytest.mark.slow]


def wait_for(tab: Tab, *said: str) -> None:
    tab.until(lambda: all(each in tab.text() for each in said), " and ".join(said))


LASTS_S = {"0.25": "3", "0.1": "2.5"}
"""A demo is watched at these speeds: a click has 8 s of the machine, on a slow page over 10.

Its recording comes in time.
"""


def watched(speed: float) -> str:
    """The speed of a run on a page: a browser without a GPU takes more than the run itself."""
    return "0.25" if speed >= 0.5 else "0.1"


def test_a_run_is_started_disturbed_and_stopped_on_the_page(speed: float, tmp_path: Path) -> None:
    """Four faults of a robot that runs, and what is said of each.

    Then the recording shows that it stands.
    """
    with (
        page_of("watch", "--port", "0", folder=tmp_path) as (address, page),
        browser(WIDTH, HEIGHT) as tab,
    ):
        tab.open(address)
        wait_for(tab, "no run: start one")
        tab.choose("0.5", watched(speed))
        # Where a blinded robot lands on its feet, however late the click comes
        tab.choose("stairs", "flat")
        tab.click("Start")
        wait_for(tab, "live", "mode_run")
        (up,) = psutil.Process(page.pid).children()
        threads = [thread.id for thread in up.threads()]  # none has the page's own, which is lower
        assert max(os.getpriority(os.PRIO_PROCESS, thread) for thread in threads) <= os.getpriority(
            os.PRIO_PROCESS, 0
        )
        tab.click("Blind the camera 1 s")
        before = tab.picture()[GROUND].astype(int)
        wait_for(tab, "blind 1", "heightmap_invalid", "mode_stopped")
        # The robot has gone on
        assert np.abs(tab.picture()[GROUND] - before).max(axis=-1).mean() > 1.0
        for label, process in (
            ("Kill the camera", "render"), ("Kill the heightmap service", "heightmap"),
            ("Kill the planner", "policy"),
        ):  # fmt: skip
            tab.click(label)
            wait_for(
                tab, f"kill {process}", f"process_died {process}", f"process_ready {process}: after"
            )
        tab.click("Stop")
        wait_for(tab, "recording", "Pause")
        assert "Stop" not in tab.text()
    recording = read_recording(next(tmp_path.glob("runs/*/recording.mcap")))
    assert recording.complete
    assert recording.of(RobotState)[-1].mode in (ControllerMode.STAND, ControllerMode.STOPPED)
    asked = [(event.code, event.detail) for event in recording.of(Event, "event/operator")]
    assert asked[0] == ("blind", "1")
    assert asked[1:] == [
        ("kill", "render"),
        ("kill", "heightmap"),
        ("kill", "policy"),
        ("stop", ""),
    ]


def test_a_demo_is_watched_and_pushed_and_then_its_recording_is_shown(
    speed: float, tmp_path: Path
) -> None:
    """Whether the robot withstands the push is a question for benchmarks."""
    slowed = watched(speed)
    demo = (
        "demo",
        "--watch",
        "--terrain",
        "flat",
        "--time-limit-s",
        LASTS_S[slowed],
        "--no-video",
        "--out",
        "run",
    )
    paced = ("--pace", "realtime", "--speed", slowed)
    with (
        page_of(*demo, *paced, folder=tmp_path) as (address, process),
        browser(WIDTH, HEIGHT) as tab,
    ):
        tab.open(address)
        wait_for(tab, "flat, seed 0", "plant/truth", "mode_run")
        tab.click("Push it to the left, 15 Ns")
        wait_for(tab, "push 15")
        wait_for(tab, "recording", "Pause")
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == -signal.SIGTERM
    recording = read_recording(tmp_path / "run" / "recording.mcap")
    assert recording.complete
    time_ns = recording.of(Event, "event/operator")[0].time_ns
    sideways = [
        t.velocity_base_in_world[1]
        for t in recording.of(GroundTruth)
        if 0 < t.time_ns - time_ns < 3e8
    ]
    assert max(sideways) > 0.5  # 15 Ns on 13 kg
