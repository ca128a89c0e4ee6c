"""Sizes that the benchmark of jumping logs hides, and how it judges what was said."""

from typing import Any

import numpy as np
import pytest

from benchmarks.jumping_logs import HIDDEN, LEAST, _hidden, _outcome, _value


@pytest.mark.parametrize(("name", "parameter"), HIDDEN)
def test_what_is_hidden_is_one_to_three_times_what_a_log_can_tell(
    name: str, parameter: str
) -> None:
    null = 1.0 if name == "torque_gain" else 0.0
    for seed in range(50):
        size = abs(_value(name, parameter, null + 0.004, np.random.default_rng(seed)) - null)
        assert 1.0 <= size / max(0.004, LEAST.get(name, 0.0)) <= 3.0


def test_every_effect_is_hidden_as_often_and_both_frictions_are() -> None:
    names = [_hidden(number)[0] for number in range(28)]
    assert set(names) == {name for name, _ in HIDDEN}
    assert all(names.count(name) == 4 for name, _ in HIDDEN if "friction" not in name)
    assert names.count("coulomb_friction") == names.count("viscous_friction") == 2


@pytest.mark.parametrize(
    ("effects", "sets", "verdict", "outcome"),
    [
        (["torque_gain"], [], "named", "right"),
        ([], [["battery_sag", "torque_gain"]], "set", "right"),
        (["payload_mass", "torque_gain"], [], "named", "wrong"),
        (["payload_mass"], [], "unexplained", "wrong"),
        ([], [], "no_gap", "no_gap"),
        ([], [["armature", "payload_mass"]], "set", "set"),
    ],
)
def test_only_a_false_name_is_wrong(
    effects: list[str], sets: list[list[str]], verdict: str, outcome: str
) -> None:
    said: dict[str, Any] = {"effects": effects, "sets": sets, "verdict": verdict}
    assert _outcome("torque_gain", said) == outcome
