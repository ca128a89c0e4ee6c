"""What all tests rely on: a core for each worker of a parallel run,
and processes that can be interrupted.
"""

import gc
import os
import random
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

QUICK = Path(__file__).parent / "saltus"

# As in commands: beside busy programs, torch's threads would wait for each other in a loop
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
if "PYTEST_XDIST_WORKER" in os.environ:
    # Torch and BLAS would start as many threads as there are cores in every worker, which would
    # wait for each other: training takes several times as long. Both read it when they are
    # imported, as do the processes that tests start.
    os.environ.setdefault("OMP_NUM_THREADS", "1")

# A shell starts so what runs in its background, and nohup; processes that a test starts and ends
# would inherit it
for number, usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, usual)


gc.disable()  # nothing of what is imported and collected becomes garbage


def pytest_addoption(parser: pytest.Parser) -> None:
    """For tools/stress_tests.py."""
    parser.addoption(
        "--order", type=int, help="seed of a random order of files, and of the tests of each"
    )


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The many quick files of tests/saltus come last:
    no worker of a parallel run waits long for the other's last.
    """
    _mark_further_cases(items)
    items.sort(key=lambda item: QUICK in item.path.parents)
    seed: int | None = config.getoption("--order")
    if seed is not None:
        order = random.Random(seed)  # noqa: S311
        order.shuffle(items)
        places = {path: order.random() for path in dict.fromkeys(item.path for item in items)}
        items.sort(key=lambda item: places[item.path])


def _mark_further_cases(items: list[pytest.Item]) -> None:
    """Makes slow all but `n` cases of a test that is marked `sample(n)`.

    The first stays, and others that are evenly spread.
    """
    cases: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("sample") and not item.get_closest_marker("slow"):
            cases.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for family in cases.values():
        mark = family[0].get_closest_marker("sample")
        assert mark is not None
        number = min(mark.args[0], len(family))
        chosen = {place * len(family) // number for place in range(number)}
        for place, item in enumerate(family):
            if place not in chosen:
                item.add_marker("slow")


def pytest_collection_finish() -> None:
    """What was imported stays: to look through it again and again
    for garbage took an eighth of the tests' time.

    Of what is new most is gone without that: it is looked through less often than Python does by
    default.
    """
    gc.freeze()
    gc.enable()
    gc.set_threshold(20_000, 20, 20)


@pytest.fixture(scope="module")
def short_calibration() -> Iterator[None]:
    """A tenth of the windows: the factor is exact for those that there are,
    and these episodes fill no more.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("saltus.heightmap.training.calibration.WINDOWS", 3)
        yield
