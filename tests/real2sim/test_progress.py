"""The progress of a comparison goes on with every simulation,
never back, and never beyond the whole.
"""

import pytest

from saltus.real2sim.progress import LEVELS, ComparisonProgress
from saltus.real2sim.sensors import SENSORS


@pytest.mark.parametrize("calls", [3, 2000])
def test_every_simulation_moves_it_on(calls: int) -> None:
    told: list[float] = []
    shown = ComparisonProgress(lambda _stage, share: told.append(share), SENSORS)
    for sensor in SENSORS:
        shown.begin(sensor.name)
        shown.end(sensor.prepare_s)
        simulated = shown.search(sensor.name, sensor.search_s)
        for stage in ("replay", *LEVELS[:3], "elimination", *LEVELS[3:]):
            for _ in range(calls):
                simulated(stage, 1)
        shown.end(sensor.search_s)
    shown.begin("conclude")
    assert told == sorted(told)
    assert 0.0 < told[0] < told[-1] < 1.0
    few = [told[i + 1] - told[i] for i in range(0, 3 * min(calls, 100))]
    assert min(few) > 0.0


def test_a_search_that_ends_early_is_jumped_over() -> None:
    told: list[float] = []
    shown = ComparisonProgress(lambda _stage, share: told.append(share), SENSORS[:1])
    shown.end(SENSORS[0].prepare_s)
    shown.search("joints", SENSORS[0].search_s)("slopes", 65)
    shown.end(SENSORS[0].search_s)
    shown.begin("conclude")
    assert told[0] < 0.3
    assert told[1] > 0.9


def test_nobody_needs_to_be_told() -> None:
    ComparisonProgress(None, SENSORS).search("joints", 1.0)("slopes", 10)
