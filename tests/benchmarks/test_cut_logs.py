"""The benchmark of cut logs counts what the whole log does not say,
and cuts long enough to say it.
"""

from typing import Any

import pytest

from benchmarks.cuts import WHOLE, Benchmark, counted
from saltus.errors import ConfigError


def row(
    cut: str, verdict: str, *effects: str, seconds: float = 10.0, is_tested: bool = True
) -> dict[str, Any]:
    said = {"verdict": verdict, "effects": list(effects), "sets": [], "is_tested": is_tested}
    return {"log": "joints", "cut": cut, "seconds_of_log": seconds, **said}


def test_cuts_are_counted_beside_the_whole_log() -> None:
    found = counted(
        [
            row(WHOLE, "named", "coulomb_friction", seconds=30.0),
            row("0", "named", "coulomb_friction"),
            row("1", "named", "stiction"),
            row("2", "unexplained", is_tested=False),
            row("3", "unexplained", seconds=7.9),
            row("4", "bad_log", is_tested=False),
            row("5", "named", "coulomb_friction", is_tested=False),
        ]
    )
    assert (found["cut"], found["other_names"], found["bad_log"], found["named_without_test"]) == (
        6,
        1,
        1,
        1,
    )
    assert (found["long"], found["long_named"]) == (2, 1)
    assert [each["cut"] for each in found["not_right"]] == ["1"]


def test_more_cuts_keep_the_lengths_of_fewer() -> None:
    few, many = (Benchmark(cuts=cuts, seed=3)._cases() for cuts in (2, 5))
    assert many[: len(few)] == few
    assert len(many) == 10 * 6
    with pytest.raises(ConfigError, match="joint"):
        Benchmark(logs=("joint",)).measure()
