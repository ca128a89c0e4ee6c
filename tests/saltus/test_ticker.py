"""Laws of clocks, ages and fixed rates."""

import ast
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from saltus import clock as clock_module
from saltus.clock import RunClock
from saltus.errors import ConfigError
from saltus.runtime import ticker as module
from saltus.runtime.ticker import Ticker
from saltus.wire.topics import TOPICS, Staleness, Topic, staleness_of

MS = 1_000_000


class FakeTime:
    """A monotonic clock that sleeping advances."""

    def __init__(self) -> None:
        self.now_ns = 5_000

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.now_ns += max(1, round(1e9 * seconds))


def stop_time(patch: pytest.MonkeyPatch, fake: FakeTime) -> None:
    for user in (module, clock_module):
        patch.setattr(user, "time", fake)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeTime:
    fake = FakeTime()
    stop_time(monkeypatch, fake)
    return fake


@pytest.mark.parametrize("topic", TOPICS.values(), ids=lambda topic: topic.name)
@given(age_ns=st.integers(-(10**9), 3 * 10**9))
def test_freshness_is_a_staircase_of_age(topic: Topic, age_ns: int) -> None:
    answer = staleness_of(topic, 10**12, 10**12 + age_ns)
    if age_ns < -5 * MS:
        expected = Staleness.FUTURE
    elif age_ns <= 1e9 * topic.degraded_age_s:
        expected = Staleness.OK
    else:
        expected = Staleness.DEGRADED if age_ns <= 1e9 * topic.invalid_age_s else Staleness.INVALID
    assert answer is expected
    assert answer.usable == (answer in (Staleness.OK, Staleness.DEGRADED))


def test_depth_is_degraded_50_ms_and_lost_100_ms_beyond_its_nominal_age() -> None:
    depth = TOPICS["camera/depth"]
    ages_ms = {70: "ok", 119: "ok", 121: "degraded", 169: "degraded", 171: "invalid"}
    assert {ms: staleness_of(depth, 0, ms * MS).value for ms in ages_ms} == ages_ms


@given(busy_ms=st.lists(st.integers(0, 95), max_size=60))
def test_ticks_stay_on_the_grid_and_never_burst(busy_ms: list[int]) -> None:
    fake = FakeTime()
    with pytest.MonkeyPatch.context() as patch:
        stop_time(patch, fake)
        ticker = Ticker(100.0)
        ticker.wait()
        start = fake.now_ns
        previous = start
        for busy in busy_ms:
            fake.now_ns += busy * MS
            ticker.wait()
            # late by less than a period, and on average never faster than the rate
            assert (fake.now_ns - start) // (10 * MS) == ticker.ticks + ticker.overruns - 1
            assert fake.now_ns >= previous
            previous = fake.now_ns
        assert ticker.ticks == len(busy_ms) + 1


def test_a_long_stall_is_counted_not_made_up_for(clock: FakeTime) -> None:
    ticker = Ticker(500.0)
    ticker.wait()
    clock.now_ns += 1_000 * MS
    assert ticker.wait() == 499
    before = clock.now_ns
    assert ticker.wait() == 0
    assert clock.now_ns - before == 2 * MS
    assert ticker.overruns == 499


def _waits_at_once(ticker: Ticker, fake: FakeTime) -> bool:
    before = fake.now_ns
    ticker.wait()
    return fake.now_ns == before


@given(stall_periods=st.integers(0, 40), catch_up=st.integers(1, 20))
def test_a_stall_is_made_up_for_up_to_the_limit_and_counted_beyond_it(
    stall_periods: int, catch_up: int
) -> None:
    fake = FakeTime()
    with pytest.MonkeyPatch.context() as patch:
        stop_time(patch, fake)
        ticker = Ticker(500.0, catch_up=catch_up)
        ticker.wait()
        start = fake.now_ns
        fake.now_ns += stall_periods * 2 * MS
        at_once = 0
        while _waits_at_once(ticker, fake):
            at_once += 1
        assert at_once <= catch_up
        assert ticker.overruns == max(0, stall_periods - 1 - (catch_up - 1))
        assert (fake.now_ns - start) // (2 * MS) == ticker.ticks + ticker.overruns - 1


def test_rate_of_a_real_loop() -> None:
    ticker = Ticker(200.0)
    start = time.monotonic()
    for _ in range(21):
        ticker.wait()
    elapsed = time.monotonic() - start
    assert elapsed >= 20 / 200 - 1e-3
    assert ticker.ticks == 21


def test_real_time_counts_from_the_epoch(clock: FakeTime) -> None:
    clock.now_ns = 12 * MS
    run = RunClock(epoch_ns=2 * MS)
    assert run.now_ns() == 10 * MS
    assert run.of_monotonic(7 * MS) == 5 * MS
    with pytest.raises(ConfigError, match="lockstep"):
        run.set(0)


@given(times=st.lists(st.integers(0, 10**12)))
def test_lockstep_time_is_what_was_set_and_never_goes_back(times: list[int]) -> None:
    run = RunClock(epoch_ns=123, lockstep=True)
    highest = 0
    for time_ns in times:
        run.set(time_ns)
        highest = max(highest, time_ns)
        assert run.now_ns() == highest


@given(
    speed=st.floats(0.01, 1.0), epoch_ns=st.integers(0, 10**15), passed_ns=st.integers(0, 10**13)
)
def test_a_slowed_clock_passes_at_its_speed_and_turns_waits_into_the_machines(
    speed: float, epoch_ns: int, passed_ns: int
) -> None:
    run = RunClock(epoch_ns, speed=speed)
    run_ns = run.of_monotonic(epoch_ns + passed_ns)
    assert run_ns == pytest.approx(speed * passed_ns, abs=1.0)
    assert 1e9 * run.machine_s(1e-9 * run_ns) == pytest.approx(passed_ns, abs=2.0 / speed, rel=1e-9)
    assert RunClock(epoch_ns).of_monotonic(epoch_ns + passed_ns) == passed_ns


@given(
    speed=st.sampled_from([1.0, 0.5, 0.25, 0.1]), busy_ms=st.lists(st.integers(0, 95), max_size=30)
)
def test_a_slowed_loop_ticks_on_the_grid_of_its_own_clock(speed: float, busy_ms: list[int]) -> None:
    fake = FakeTime()
    with pytest.MonkeyPatch.context() as patch:
        stop_time(patch, fake)
        ticker = Ticker(100.0, clock=RunClock(fake.now_ns, speed=speed))
        ticker.wait()
        start = fake.now_ns
        for busy in busy_ms:
            fake.now_ns += busy * MS
            ticker.wait()
            run_ns = speed * (fake.now_ns - start)
            assert (run_ns + 2) // (10 * MS) == ticker.ticks + ticker.overruns - 1


ROOT = Path(__file__).parents[2]
WALL = {("time", "time"), ("time", "time_ns"), ("time", "localtime"), ("time", "gmtime"),
    ("time", "ctime"),
        ("datetime", "now"), ("datetime", "utcnow"), ("datetime", "today"), ("date", "today"),
        ("time", "CLOCK_REALTIME")}  # fmt: skip
READ_BY = {
    "saltus/folders.py": "the names of folders",
    "saltus/wire/certificates.py": "how long certificates hold",
    "saltus/ros2/bridge.py": "what ROS wants to know of a sender",
    "saltus/ros2/wall_clock.py": "stamps of ROS, which are of that clock",
    "saltus/wire/zenoh_bus.py": "Zenoh's dates, held between two drains by the monotonic clock",
    "controller/robot/unitree/log.py": "the date of a log, read once",
}


def test_nothing_but_names_certificates_and_what_ros_stamps_is_of_the_wall_clock() -> None:
    """Who sets it while a robot runs changes no age, no limit and no order."""
    rooms = ("saltus", "heightmap", "render", "policy", "controller", "real2sim")
    found = {
        path.relative_to(ROOT).as_posix()
        for room in rooms
        for path in (ROOT / room).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and (node.value.id, node.attr) in WALL
        )
        or (
            isinstance(node, ast.ImportFrom)
            and any((node.module, name.name) in WALL for name in node.names)
        )
    }
    assert found == set(READ_BY)
