"""A program's process and the one that waits to take over."""

import os
import select
import signal
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from limits import files_left

from saltus.clock import RunClock
from saltus.errors import StackError
from saltus.runtime.child import Child, Program

BEGUN, REFUSED = 7, 8
WAITS = f"""
import sys
from saltus.runtime import cue

sys.exit({BEGUN} if cue.await_cue(lambda: False) else {REFUSED})
"""
DIES = "raise SystemExit(3)"


@pytest.fixture
def child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Child]:
    (tmp_path / "waits.py").write_text(WAITS)
    (tmp_path / "dies.py").write_text(DIES)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    subject = Child(
        Program(name="waits", module="waits", restart=True), tmp_path / "log", RunClock()
    )
    yield subject
    subject.dismiss()
    subject.kill()


def wait_until_loaded(child: Child) -> int:
    assert child._waits is not None
    select.select([child._waits._line], [], [])  # it says that it waits, or ends
    return child._waits.process.pid


def wait_for_end(child: Child) -> int:
    assert child._runs is not None
    return child._runs.process.wait(10.0)


def test_what_has_loaded_waits_and_is_what_begins(child: Child) -> None:
    child.load([])
    pid = wait_until_loaded(child)
    assert not child.loading
    assert not child.running()
    assert child.exit_code() is None
    child.begin([])
    assert child._runs is not None
    assert child._runs.process.pid == pid
    assert wait_for_end(child) == BEGUN
    assert not child.loading


def test_it_begins_without_one_that_waits(child: Child) -> None:
    child.begin([])
    assert wait_for_end(child) == BEGUN


def test_one_that_died_while_it_waited_is_replaced(child: Child) -> None:
    child.load([])
    os.kill(wait_until_loaded(child), signal.SIGKILL)
    assert child._waits is not None
    child._waits.process.wait(10.0)
    assert not child.loading
    child.begin([])
    assert wait_for_end(child) == BEGUN


def test_one_that_cannot_load_does_not_keep_others_waiting(tmp_path: Path, child: Child) -> None:
    broken = Child(Program(name="dies", module="dies", restart=True), tmp_path / "log", RunClock())
    broken.load([])
    wait_until_loaded(broken)
    broken.begin([])
    assert wait_for_end(broken) == 3
    broken.kill()


def test_one_that_waits_does_not_outlive_its_supervisor(child: Child) -> None:
    child.load([])
    wait_until_loaded(child)
    assert child._waits is not None
    child._waits._line.close()
    assert child._waits.process.wait(10.0) == REFUSED


@pytest.mark.parametrize("left", [0, 2, 3])
def test_where_the_system_gives_no_more_files_it_is_told_and_none_stays_open(
    left: int, child: Child
) -> None:
    """Those of its line take two, its log takes one, and what starts a process some more."""
    before = psutil.Process().num_fds()
    with (
        files_left(left),
        pytest.raises(StackError, match=r"^waits cannot be started: Too many open files$"),
    ):
        child.load([])
    assert psutil.Process().num_fds() == before
    assert not child.has_spare
    child.begin([])
    assert wait_for_end(child) == BEGUN
