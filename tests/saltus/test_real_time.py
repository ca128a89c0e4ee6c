"""Laws of the monitor of real time: it follows what the processes tell,
and advises a speed that helps.
"""

import itertools
import pickle
import time
from collections import defaultdict
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from saltus.clock import RunClock
from saltus.runtime.real_time import SPEEDS, RealTimeFactor, RealTimeMonitor
from saltus.wire.messages import ProcessStatus
from saltus.wire.topics import TOPICS

PERIOD_S = 0.5  # of the machine, from one status to the next


def status(process: str, time_s: float, **received: tuple[int, float]) -> ProcessStatus:
    keys = {name.replace("_", "/"): value for name, value in received.items()}
    return ProcessStatus(
        time_ns=round(1e9 * time_s),
        process=process,
        ready=True,
        ticks=0,
        overruns=0,
        received={key: count for key, (count, _) in keys.items()},
        silence_us={key: round(1e6 * silence_s) for key, (_, silence_s) in keys.items()},
    )


class Numbered:
    """Statuses of a monitor, numbered process by process as their senders do;
    some are lost on their way.
    """

    def __init__(self, monitor: RealTimeMonitor) -> None:
        self._monitor = monitor
        self._numbers: defaultdict[str, itertools.count[int]] = defaultdict(itertools.count)

    def take(self, told: ProcessStatus, *, lost: bool = False) -> None:
        number = next(self._numbers[told.process])
        if not lost:
            self._monitor.take(told, number)


def verdict_of(
    share: float,
    late_s: float,
    speed: float,
    seconds: float = 2.9,
    lost: frozenset[int] = frozenset(),
) -> RealTimeFactor | None:
    """What is said that long after the robot's first word,
    where one stream brings `share` and the other keeps up; `lost` are statuses of the former.
    """
    now_ns = time.monotonic_ns()
    clock = RunClock(now_ns - round(1e9 * seconds), speed=speed)
    monitor = RealTimeMonitor(clock, robot="controller")
    numbered = Numbered(monitor)
    numbered.take(status("controller", 0.0))
    for k in range(int(seconds / PERIOD_S) + 1):
        length_s = PERIOD_S * speed
        asked = TOPICS["policy/plan"].rate_hz * length_s
        numbered.take(
            status("controller", k * length_s, policy_plan=(round(share * asked), 0.01 + late_s)),
            lost=k in lost,
        )
        numbered.take(status("policy", k * length_s, controller_state=(round(asked), 0.01)))
    return monitor.verdict()


def test_what_a_trial_draws_is_not_held_against_the_computer() -> None:
    """Images come up to 10 ms after the one before them and its period, by jitter alone."""
    clock = RunClock(time.monotonic_ns() - 2_900_000_000)
    for beyond_s, late_s in ((0.010, 0.0), (0.015, 0.005)):
        monitor = RealTimeMonitor(clock, robot="controller")
        numbered = Numbered(monitor)
        numbered.take(status("controller", 0.0))
        for k in range(6):
            asked = round(TOPICS["camera/depth"].rate_hz * PERIOD_S)
            numbered.take(status("heightmap", k * PERIOD_S, camera_depth=(asked, 0.020 + beyond_s)))
        factor = monitor.verdict()
        assert factor is not None
        assert factor.late_s == pytest.approx(late_s, abs=1e-6)


@given(parts=st.lists(st.floats(0.0, 1.0), min_size=6, max_size=6), share=st.floats(0.05, 1.0))
def test_plans_and_joint_targets_are_one_stream(parts: list[float], share: float) -> None:
    """A planner that can walk sends one of them at a time, and changes at any moment."""
    clock = RunClock(time.monotonic_ns() - 2_900_000_000)
    monitor = RealTimeMonitor(clock, robot="controller")
    numbered = Numbered(monitor)
    asked = TOPICS["policy/plan"].rate_hz * PERIOD_S
    for k, part in enumerate(parts):
        came = round(share * asked)
        plans = round(part * came)
        silent = {True: 0.01, False: PERIOD_S}
        numbered.take(
            status(
                "controller", k * PERIOD_S,
                policy_plan=(plans, silent[plans > came - plans]),
                policy_joints=(came - plans, silent[plans <= came - plans]),
            )
        )  # fmt: skip
    factor = monitor.verdict()
    assert factor is not None
    assert factor.late_s == 0.0
    assert factor.stream in ("policy/plan to controller", "policy/joints to controller")
    if len({part < 0.5 for part in parts}) == 1:
        assert factor.share == pytest.approx(share, abs=1.0 / asked)


@pytest.mark.parametrize("speed", [1.0, 0.4])
def test_within_three_seconds_it_is_known(speed: float) -> None:
    assert verdict_of(1.0, 0.0, speed, seconds=2.0) is None
    assert verdict_of(1.0, 0.0, speed, seconds=2.9) is not None


@given(
    share=st.floats(0.05, 1.0), late_s=st.floats(0.0, 1.0), speed=st.sampled_from([1.0, 0.5, 0.2]),
)  # fmt: skip
def test_what_keeps_up_stays_and_what_does_not_is_to_run_slower(
    share: float, late_s: float, speed: float
) -> None:
    factor = verdict_of(share, late_s, speed)
    assert factor is not None
    # A stream of few messages in half a second knows its share in steps of one message
    step = 1.0 / (TOPICS["policy/plan"].rate_hz * PERIOD_S * speed)
    assert factor.reached == pytest.approx(factor.share * speed)
    if share < 0.9 - step or late_s > 0.051:
        assert not factor.kept
        assert factor.stream == "policy/plan to controller"
        assert factor.share == pytest.approx(share, abs=step)
        assert factor.speed in SPEEDS
        assert factor.speed < speed
        assert f"--speed {factor.speed:g}" in str(factor)
        assert f"{factor.reached:.0%}" in str(factor)
    elif share > 0.9 + step and late_s < 0.049:
        assert factor.kept
        assert factor.speed == speed


@given(lost=st.frozensets(st.integers(1, 5), max_size=5), share=st.floats(0.05, 0.95))
def test_a_status_that_is_lost_says_nothing_of_what_its_process_received(
    lost: frozenset[int], share: float
) -> None:
    factor, whole = verdict_of(share, 0.0, 1.0, lost=lost), verdict_of(share, 0.0, 1.0)
    assert factor is not None
    assert whole is not None
    seen = set(range(2, 6)) - lost - {k + 1 for k in lost}
    if seen:
        assert (factor.share, factor.kept, factor.stream) == (whole.share, whole.kept, whole.stream)
    else:
        assert factor.kept
        assert factor.stream == "controller/state to policy"


@given(share=st.floats(0.05, 1.0), late_s=st.floats(0.06, 1.0))
def test_a_worse_computer_is_never_told_a_higher_speed(share: float, late_s: float) -> None:
    better, worse = verdict_of(share, late_s, 1.0), verdict_of(0.8 * share, 1.5 * late_s, 1.0)
    assert better is not None
    assert worse is not None
    assert worse.speed <= better.speed


def test_what_was_told_long_ago_is_forgotten_also_where_nobody_asks() -> None:
    monitor = RealTimeMonitor(RunClock(), robot="controller")
    sizes = []
    for k in range(1000):
        monitor.take(status("controller", k * PERIOD_S, policy_plan=(50, 0.01)), k)
        sizes.append(len(pickle.dumps(monitor)))
    assert max(sizes[500:]) <= max(sizes[:50]) + 16  # numbers grow


def test_a_run_that_has_not_begun_is_not_judged() -> None:
    clock = RunClock(time.monotonic_ns() - 10**10)
    monitor = RealTimeMonitor(clock, robot="controller")
    monitor.take(replace(status("policy", 9.0), ready=True), 1)
    assert monitor.verdict() is None
