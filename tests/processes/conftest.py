"""How fast the clock of a real-time test may run on this computer, as busy as it is now."""

import os
import statistics
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks._kills import ON_FLAT_GROUND
from saltus.runtime.real_time import RealTimeFactor
from saltus.runtime.stack import Stack

MEASURED_S = 4.0  # of standing and running; the machine's time
TRIED = (0.7, 0.5)
"""The speeds at which it is measured, the second where a run does not keep the first: at full speed
a run alone fills two cores, and its own stalls say little about a slower one. None is faster,
although a larger computer could."""
KEPT = 0.98  # of a speed: such a run is not held up
LATE_S = 0.003
"""A test's limits are a policy step or two beyond what the processes need: stalls of the computer
must be shorter."""
RESERVE = 0.5  # another moment may be twice as busy
SPIN = """import time
begin = time.perf_counter()
while time.perf_counter() < begin + 0.5:
    pass
print(time.process_time() / 0.5)"""
STEPS = (*TRIED, 0.4, 0.3, 0.25, 0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests that ask for a speed have limits in real time, and come alone.

    One that fails comes once more, at half the speed: the computer may have become busier since
    its speed was measured, and what is wrong with Saltus fails again.
    """
    for item in items:
        if Path(__file__).parent in item.path.parents and "first_speed" in getattr(
            item, "fixturenames", ()
        ):
            item.add_marker("realtime")
            item.add_marker(pytest.mark.flaky(reruns=1))


@pytest.fixture
def speed(first_speed: float, request: pytest.FixtureRequest) -> float:
    """Seconds of a run for each second of this computer."""
    return first_speed * 0.5 ** (request.node.execution_count - 1)


@pytest.fixture(scope="session")
def first_speed(tmp_path_factory: pytest.TempPathFactory) -> float:
    """The speed at which a test is tried first.

    Told, as the tests' length depends on it.
    """
    for tried in TRIED:
        factor, share = measured(tmp_path_factory.mktemp("speed"), tried)
        if factor.share > KEPT:
            break
    kept = 1.0 if factor.share > KEPT else RESERVE * factor.share
    given = tried * min(kept, LATE_S / max(factor.late_s, LATE_S), share)
    speed = next((step for step in STEPS if step <= given), STEPS[-1])
    sys.stdout.write(f"speed {speed:g}: {factor}; {share:.0%} of the processors\n")
    return speed


def measured(directory: Path, speed: float) -> tuple[RealTimeFactor, float]:
    """What a run at such a speed reaches, and the share of its processors that it gets."""
    with Stack(replace(ON_FLAT_GROUND, speed=speed), directory) as stack:
        stack.wait(speed * MEASURED_S)
        factor = stack.real_time
    assert factor is not None, "the run was over before it could be measured"
    return factor, processor_share()


def processor_share() -> float:
    """Of the time of its processors, what this session gets:
    1 where it is alone, rounded up from 0.9.

    The processes of a run may be preferred; a test's own thread, which starts, ends and dates
    things, is not.
    """
    spinning = [
        subprocess.Popen([sys.executable, "-c", SPIN], stdout=subprocess.PIPE, text=True)
        for _ in range(len(os.sched_getaffinity(0)))
    ]
    share = statistics.mean(float(process.communicate()[0]) for process in spinning)
    return 1.0 if share > 0.9 else share
