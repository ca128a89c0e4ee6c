"""Two robots that share a router are watched in a real browser, and one of them falls silent."""

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from browser import browser
from page import page_of
from recorded import run_messages
from samples import put_run

from saltus.clock import RunClock
from saltus.config import RunConfig, to_toml
from saltus.runtime.run_folder import CLIENT_FILE, RUN_FILE
from saltus.wire.joining import write_client
from saltus.wire.router import open_router
from saltus.wire.zenoh_bus import ZenohBus

ROBOTS = ("fleet/0", "fleet/1")
PERIOD_S = 0.02


class Sender:
    """Says what a robot says, every 20 ms."""

    def __init__(self, endpoint: str, prefix: str, clock: RunClock) -> None:
        self.ended = threading.Event()
        self._bus, self._clock = ZenohBus(endpoint, prefix), clock
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def end(self) -> None:
        self.ended.set()
        self._thread.join()
        self._bus.close()

    def _run(self) -> None:
        keys = [key for key, _ in run_messages(0)]
        publishers = {
            key: self._bus.publisher(*(key.split("/") if "status" in key else (key,)))
            for key in keys
        }
        while not self.ended.wait(PERIOD_S):
            now_ns = self._clock.now_ns()
            for key, message in run_messages(0):
                publishers[key].put(replace(message, time_ns=now_ns))


@pytest.fixture
def robots(tmp_path: Path) -> Iterator[list[Sender]]:
    config = RunConfig(
        robot="go1", grid="line", pace="realtime", epoch_ns=time.monotonic_ns() - 10**9
    )
    (put_run(tmp_path, config) / RUN_FILE).write_text(to_toml(config))
    endpoint, router = open_router()
    write_client(tmp_path / CLIENT_FILE, endpoint)
    senders = [Sender(endpoint, prefix, RunClock.of(config)) for prefix in ROBOTS]
    yield senders
    for sender in senders:
        sender.end()
    router.close()


@pytest.mark.slow
def test_each_robot_has_a_panel_and_one_that_falls_silent_is_told(
    robots: list[Sender], tmp_path: Path
) -> None:
    command = ("watch", str(tmp_path), "--robots", *ROBOTS, "--port", "0")
    with page_of(*command, folder=tmp_path) as (address, _), browser(1200, 480) as tab:
        tab.open(address)
        tab.until(
            lambda: all(f"{prefix}: stairs" in tab.text() for prefix in ROBOTS),
            "a panel of each robot",
        )
        tab.until(lambda: tab.text().count("mean error") == 2, "heights of each robot")
        assert "Faults" not in tab.text()  # the buttons are for the one robot of a run
        robots[1].end()
        tab.until(lambda: tab.text().count("silent") == 6, "six silent topics")
        assert tab.text().count("mean error") == 1
