"""A replay never sleeps longer than a frame's period,
holds few frames, and tells stamps that go back or jump.
"""

import json
import time
import weakref
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from realsense_bag import write_bag

from saltus.cli.main import main
from saltus.heightmap.service.steady_stamps import SteadyStamps
from saltus.recordings import realsense
from saltus.wire.messages import DepthFrame

S, MS = 1_000_000_000, 1_000_000
EVEN = [100 * S + i * 33 * MS for i in range(12)]


def shifted(first: int, by_ns: int) -> list[int]:
    """All from one image on."""
    return [stamp + by_ns * (i >= first) for i, stamp in enumerate(EVEN)]


def one(which: int, stamp_ns: int) -> list[int]:
    return [stamp_ns if i == which else stamp for i, stamp in enumerate(EVEN)]


STAMPS: dict[str, tuple[list[int], int, float]] = {
    "even": (EVEN, 0, 0.0),
    "6 a second": ([i * 167 * MS for i in range(12)], 0, 0.0),
    "90 a second": ([i * 11 * MS for i in range(12)], 0, 0.0),
    "some are lost": ([EVEN[i] for i in (0, 1, 2, 3, 9, 10, 11)], 0, 0.0),
    "with jitter": ([stamp + (i % 3) * 9 * MS for i, stamp in enumerate(EVEN)], 0, 0.0),
    "back a little": (shifted(5, -34 * MS), 1, -0.001),
    "back by 50 s": (shifted(5, -50 * S), 1, -49.967),
    "back twice": (shifted(5, -50 * S)[:8] + shifted(8, -90 * S)[8:], 2, -49.967),
    "on by 2 s": (shifted(5, 2 * S), 1, 2.033),
    "on by two hours": (shifted(5, 7200 * S), 1, 7200.033),
    "from the start of a computer to the clock on the wall": (
        shifted(5, 1_700_000_000 * S),
        1,
        1.7e9,
    ),
    "from the clock on the wall to zero": (
        [stamp + 1_700_000_000 * S for stamp in EVEN[:6]] + EVEN[6:],
        1,
        -1.7e9,
    ),
    "one is zero": (one(6, 0), 2, 100.231),
    "the first is zero": (one(0, 0), 1, 100.033),
    "one is far ahead": (one(6, 2_000_000_000 * S), 2, 2e9),
    "one twice": (one(6, EVEN[5]), 1, 0.0),
    "all the same": (12 * [100 * S], 11, 0.0),
    "all zero": (12 * [0], 11, 0.0),
    "in reverse": (EVEN[::-1], 11, -0.033),
}
"""Stamps, how many do not go on, and the largest of these steps."""


@pytest.mark.parametrize("name", STAMPS)
def test_time_goes_on_and_what_did_not_is_counted(name: str) -> None:
    stamps_ns, count, largest_s = STAMPS[name]
    stamps = SteadyStamps()
    steady = [stamps.step(stamp) for stamp in stamps_ns]
    steps = np.diff(steady)
    assert (steps > 0).all()
    assert (steps <= S).all()
    assert steady[0] == stamps_ns[0]
    assert stamps.count == count
    assert stamps.largest_s == pytest.approx(largest_s, rel=1e-6)
    assert bool(stamps.note()) == (count > 0)
    if not count:
        assert steady == stamps_ns


@pytest.mark.sample(6)
@pytest.mark.parametrize("name", STAMPS)
def test_a_recording_is_served_at_its_own_pace_without_a_longer_sleep(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stamps_ns, count, largest_s = STAMPS[name]
    bag, slept = write_bag(tmp_path / "desk.bag", stamps_ns=stamps_ns), []
    monkeypatch.setattr(time, "sleep", slept.append)
    assert main(["heightmap", "serve", "--recording", str(bag), "--assume-level"]) == 0
    steps_s = [1e-9 * step for step in np.diff(stamps_ns) if 0 < step <= S]
    # The first is taken before others are known
    period_s = max(np.median(steps_s), 0.033) if steps_s else 0.02
    assert max(slept) <= period_s + 1e-9
    assert len(slept) == len(stamps_ns) - 1
    told = capsys.readouterr()
    assert told.out.count("frame ") == len(stamps_ns)
    assert told.err.count("\n") == (count > 0)
    if count:
        assert f"jump {count} times" in told.err
        assert float(told.err.split(", by ")[1].split(" s ")[0]) == pytest.approx(
            largest_s, rel=1e-4
        )


@pytest.mark.parametrize("name", ["even", "one is zero", "on by two hours"])
def test_a_replay_tells_them_too(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stamps_ns, count, largest_s = STAMPS[name]
    bag = write_bag(tmp_path / "desk.bag", stamps_ns=stamps_ns)
    assert main(["replay", str(bag), "--assume-level", "--json"]) == 0
    told = capsys.readouterr()
    table = json.loads(told.out)
    assert (table["jumps"], table["largest_jump_s"]) == (count, pytest.approx(largest_s, rel=1e-6))
    assert table["status"] == {"ok": len(stamps_ns)}
    assert told.err.count("\n") == (count > 0)


@pytest.mark.parametrize("command", [["replay"], ["heightmap", "serve", "--recording"]])
def test_few_frames_are_held_however_long_a_recording_is(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = write_bag(tmp_path / "desk.bag", frames=90)
    alive: weakref.WeakSet[DepthFrame] = weakref.WeakSet()
    most, read = 0, realsense.read_realsense

    def watched(path: Path) -> Iterator[DepthFrame]:
        nonlocal most
        for frame in read(path):
            alive.add(frame)
            most = max(most, len(alive))
            yield frame

    monkeypatch.setattr(realsense, "read_realsense", watched)
    monkeypatch.setattr(time, "sleep", lambda _: None)
    assert main([*command, str(bag), "--assume-level"]) == 0
    assert 1 <= most <= 6
