"""What a process does besides its work: proof of life, a clean end, errors as one line."""

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from memory_bus import MemoryBus

from saltus import clock as clock_module
from saltus.config import RunConfig, to_toml
from saltus.errors import ModelError
from saltus.runtime.process import EXIT_ERROR, ProcessContext, run_process
from saltus.runtime.run_folder import RUN_FILE
from saltus.wire.bus import Latest
from saltus.wire.router import open_router


class FakeTime:
    """A monotonic clock that stands still until it is moved."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic_ns(self) -> int:
        return round(1e9 * self.now_s)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeTime:
    fake = FakeTime()
    monkeypatch.setattr(clock_module, "time", fake)
    return fake


def context(bus: MemoryBus) -> tuple[ProcessContext, Latest]:
    status = bus.latest("status", "render")
    return ProcessContext(
        "render", RunConfig(robot="go1", grid="line", pace="lockstep"), Path(), bus
    ), status


def test_nothing_is_said_before_it_is_ready_and_then_twice_a_second(clock: FakeTime) -> None:
    bus = MemoryBus("robot/0")
    subject, status = context(bus)
    subject.beat(ticks=1)
    assert status.take() is None
    subject.ready()
    assert status.take() is not None
    sent = 0
    for tick in range(1000):  # 10 s at 100 Hz
        clock.now_s += 0.01
        subject.beat(ticks=tick, overruns=3)
        sent += status.take() is not None
    assert 19 <= sent <= 20
    assert not subject.stopped


def test_the_status_tells_what_was_refused(clock: FakeTime) -> None:
    bus = MemoryBus("robot/0")
    subject, status = context(bus)
    bus.rejected["camera/depth/range"] = 4
    subject.ready()
    sample = status.take()
    assert sample is not None
    assert sample.message.rejected == {"camera/depth/range": 4}
    assert sample.message.ready


def test_a_process_stops_when_its_router_is_gone_for_two_seconds_and_says_why(
    clock: FakeTime, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    subject, _ = context(MemoryBus("robot/0"))
    subject.ready()
    monkeypatch.setattr(MemoryBus, "connected", lambda _: False)
    for _ in range(4):
        clock.now_s += 0.499
        subject.beat(ticks=0)
        assert not subject.stopped
    clock.now_s += 1.0
    subject.beat(ticks=0)
    assert subject.stopped
    assert "router has not answered for 2 s" in capsys.readouterr().err


@pytest.mark.parametrize("stood_s", [0.6, 2.5, 60.0, 1e5])
def test_a_process_that_stood_still_itself_looks_for_its_router_again(
    stood_s: float, clock: FakeTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where a computer sleeps: links are given up meanwhile, and come back."""
    subject, _ = context(MemoryBus("robot/0"))
    subject.ready()
    for connected in (False, False, True) * 3:
        clock.now_s += stood_s if not connected else 0.5
        monkeypatch.setattr(MemoryBus, "connected", lambda _, now=connected: now)
        subject.beat(ticks=0)
        assert not subject.stopped


def test_a_process_stops_when_its_parent_is_gone(
    clock: FakeTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "getppid", lambda: 4711)
    subject, _ = context(MemoryBus("robot/0"))
    monkeypatch.setattr(os, "getppid", lambda: 1)
    subject.ready()
    assert subject.stopped


@pytest.fixture
def handlers() -> Iterator[None]:
    """A process of its own need not put signal handlers back; a test must."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("handlers")
def test_errors_are_one_line_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def body(_: ProcessContext) -> None:
        raise ModelError("the model file is damaged")

    endpoint, router = open_router()
    (tmp_path / RUN_FILE).write_text(to_toml(RunConfig(robot="go1", grid="line")))
    arguments = ["--run-dir", str(tmp_path), "--endpoint", endpoint]
    assert run_process("heightmap", body, arguments) == EXIT_ERROR
    assert capsys.readouterr().err == "heightmap: the model file is damaged\n"
    assert run_process("heightmap", lambda _: None, arguments) == 0
    (tmp_path / RUN_FILE).write_text("sead = 3\n")
    assert run_process("heightmap", body, arguments) == EXIT_ERROR
    assert "unknown key 'sead'" in capsys.readouterr().err
    router.close()


def test_what_a_process_waits_for_does_not_outlast_its_patience() -> None:
    bus = MemoryBus("robot/0")
    start = time.monotonic()
    assert bus.latest("policy/plan").wait(0.02) is None
    assert 0.02 <= time.monotonic() - start < 1.0
