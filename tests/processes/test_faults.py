"""A process is killed in the middle of a run: a standby takes over, or the robot lands and stands.

Both are told.
"""

from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks._judgement import (
    PRODUCT,
    decided_ns,
    heard_alone_ns,
    judge,
    last_before,
    late_uses,
)
from benchmarks._kills import ON_FLAT_GROUND, kill_during_run
from saltus.constants import POLICY_DT
from saltus.controller.watchdog import LOST_AGE_S
from saltus.errors import StackError
from saltus.heightmap.service.image_watch import LOSS_MARGIN_S
from saltus.recordings.recording import Recording, read_recording
from saltus.runtime.programs import WITH_STANDBYS
from saltus.wire.codec import Envelope
from saltus.wire.topics import MAX_EXTRA_AGE_S


@pytest.mark.slow
def test_a_spare_camera_takes_over_or_the_robot_stands(speed: float, tmp_path: Path) -> None:
    """Its first image is 50 ms old when it comes:
    whether that is in time depends on the computer.
    """
    first, both, config = (
        tmp_path / "first",
        tmp_path / "both",
        replace(ON_FLAT_GROUND, speed=speed),
    )
    result = judge(kill_during_run(config, first, "render", 0.7, watch_s=0.5), "render", 0.7)
    assert result.end == "goes on" or result.silence_ms > 1e3 * (
        MAX_EXTRA_AGE_S - LOSS_MARGIN_S - POLICY_DT
    )
    assert result.stale == 0
    result = judge(kill_during_run(config, both, "render", 0.7, times=2), "render", 0.7)
    assert result.told_ms <= 110.0
    assert result.back_s <= 2.0
    assert result.end == "stands"
    assert result.stale == 0


@pytest.mark.parametrize("process", ["heightmap", pytest.param("policy", marks=pytest.mark.slow)])
def test_a_killed_process_is_noticed_and_the_robot_stands(
    process: str, speed: float, tmp_path: Path
) -> None:
    after_s = {"heightmap": 0.9, "policy": 1.1}[process]
    recording = kill_during_run(replace(ON_FLAT_GROUND, speed=speed), tmp_path, process, after_s)
    result = judge(recording, process, after_s)
    assert result.told_ms <= 110.0
    assert result.back_s <= 2.0
    assert result.end == "stands"
    assert result.stale == 0
    incomplete = Incomplete(recording, process)
    found = judge(incomplete, process, after_s)
    assert found.told_ms == pytest.approx(result.told_ms + incomplete.lost_ms - 1e3 * POLICY_DT), (
        "as if it were there"
    )


class Incomplete(Recording):
    """A recording without the last message of a process that was killed:
    its consumer alone had it.
    """

    def __init__(self, recording: Recording, process: str) -> None:
        super().__init__(
            **{field.name: getattr(recording, field.name) for field in fields(recording)}
        )
        events = recording.messages("event/supervisor")
        died_ns = next(
            arrival for arrival, _, event in events if getattr(event, "code", "") == "process_died"
        )
        product = [row[:2] for row in recording.payloads(PRODUCT[process])]
        dead = [envelope.boot_id for arrival, envelope in product if arrival <= died_ns][-1]
        (before_ns, _), (last_ns, self._missing) = [
            row for row in product if row[1].boot_id == dead
        ][-2:]
        self.lost_ms = 1e-6 * (last_ns - before_ns)

    def payloads(self, topic: str) -> Iterator[tuple[int, Envelope, bytes]]:
        return (row for row in super().payloads(topic) if row[1] != self._missing)


@pytest.mark.slow
@pytest.mark.parametrize("process", ["heightmap", "policy"])
def test_the_robot_goes_on_if_a_standby_is_in_time(
    process: str, speed: float, tmp_path: Path
) -> None:
    config, after_s = replace(ON_FLAT_GROUND, speed=speed), 0.9
    recording = kill_during_run(
        config, tmp_path, process, after_s, watch_s=0.5, programs=WITH_STANDBYS
    )
    result = judge(recording, process, after_s)
    assert result.end == "goes on" or result.silence_ms > 1e3 * (LOST_AGE_S - 2.0 * POLICY_DT)
    assert result.stale == 0


@pytest.mark.parametrize("seed", range(5))
def test_uses_are_late_whose_newest_source_is_older_than_the_limit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    uses, sources = (np.sort(rng.integers(0, 10**9, 200)) for _ in range(2))
    late = [
        not any(0 <= use - source <= 5_000_000 for source in sources.tolist())
        for use in uses.tolist()
    ]
    assert late_uses(uses.tolist(), sources.tolist(), 0.005) == sum(late) > 0
    assert late_uses(uses.tolist(), [], 1.0) == 200


@pytest.mark.parametrize("late", [0, 1, 2])
@pytest.mark.parametrize("standbys", [0, 1])
def test_what_a_process_sent_last_is_its_own_also_if_it_is_read_after_the_death(
    late: int, standbys: int
) -> None:
    died_ns, first = 1_000, standbys * [(k, b"first") for k in range(0, 500, 10)]
    dead = [(died_ns + 10 * k, b"dead") for k in range(late - 20, late)]
    assert last_before([*first, *dead, (2_000, b"next")], died_ns) == dead[-1][0]
    assert last_before([(2_000, b"next")], died_ns) == 0


@pytest.mark.parametrize("rate_hz", [30.0, 100.0])
@pytest.mark.parametrize("periods", range(-3, 4))
def test_whole_periods_that_only_a_consumer_heard_count(periods: int, rate_hz: float) -> None:
    period_ns = round(1e9 / rate_hz)
    for rounding_ns in (-500_000, 0, 500_000, 5_000_000):
        assert (
            heard_alone_ns(periods * period_ns + rounding_ns, rate_hz)
            == max(0, periods) * period_ns
        )


@pytest.mark.parametrize("held_up_ns", [0, 7, 400_000_000])
def test_what_a_state_tells_was_decided_before_it_and_while_the_controller_was_awake(
    held_up_ns: int,
) -> None:
    step_ns = round(1e9 * POLICY_DT)
    times = np.cumsum([0, step_ns, step_ns - 5, step_ns + held_up_ns, step_ns]).tolist()
    decided = decided_ns(times)
    assert all(
        0 < now - then <= max(1, held_up_ns) for now, then in zip(times, decided, strict=True)
    )
    assert late_uses(decided, [-step_ns, *times[:-1]], 1e-9 * step_ns) == 0, (
        "plans of the step before"
    )
    assert late_uses(decided[3:], times[:1], 1e-9 * step_ns) == 2, "plans that no longer come"


def test_a_killed_controller_ends_the_run_and_leaves_a_recording(
    speed: float, tmp_path: Path
) -> None:
    with pytest.raises(StackError, match=r"controller died \(.*SIGKILL"):
        kill_during_run(replace(ON_FLAT_GROUND, speed=speed), tmp_path, "controller", 0.5)
    recording = read_recording(tmp_path / "recording.mcap")
    assert recording.lost == []
    assert sum(1 for _ in recording.messages("controller/state")) > 100
