"""verdict.json: its keys, and one verdict of what several sensors say."""

import json
from typing import Any

import pytest

from saltus.real2sim.problem.problem import ParameterEstimate
from saltus.real2sim.search.findings import (
    FoundEffect,
    ParameterInterval,
    ProblemRuling,
    SearchFindings,
    SignalGap,
)
from saltus.real2sim.verdict import (
    NextExperiment,
    ResidualGap,
    Verdict,
    effect_from_dict,
    merge_findings,
)

EFFECT = FoundEffect(
    name="torque_saturation",
    where=("FR_calf",),
    params={"knee": ParameterInterval(value=14.2, ci90=(13.6, 14.9), unit="Nm")},
)


def findings(problem: str, verdict: ProblemRuling, **more: Any) -> SearchFindings:
    gap = SignalGap(signal="q", residuals=100, before=5.0, after=1.5, floor=1.0)
    return SearchFindings(problem=problem, verdict=verdict, gaps=(gap,), **more)


def test_json_holds_all_of_a_verdict() -> None:
    verdict = Verdict(
        verdict="set",
        effects=(EFFECT,),
        sets=(("actuator_lag", "command_delay"),),
        next_experiment=NextExperiment(
            name="joint_chirp", why="reaches 20 Hz", expected_separation=40.0
        ),
        untestable={"backlash": "no reversal of load"},
        gap=ResidualGap(before=4.0, after=1.5, floor=1.0),
        minimum_detectable={"coulomb_friction": ParameterEstimate(value=0.04, unit="Nm")},
    )
    data = json.loads(verdict.to_json())
    assert data == verdict.to_dict()
    assert data["sets"] == [["actuator_lag", "command_delay"]]
    assert data["next_experiment"] == {
        "name": "joint_chirp",
        "why": "reaches 20 Hz",
        "expected_separation": 40.0,
    }
    assert data["untestable"] == [{"name": "backlash", "why": "no reversal of load"}]
    assert data["minimum_detectable"] == {"coulomb_friction": {"value": 0.04, "unit": "Nm"}}
    assert effect_from_dict(data["effects"][0]) == EFFECT


def test_json_has_the_keys_of_the_schema() -> None:
    data = Verdict(
        verdict="named", effects=(EFFECT,), gap=ResidualGap(before=5.0, after=2.0, floor=1.0)
    ).to_dict()
    assert set(data) == {
        "verdict",
        "effects",
        "sets",
        "next_experiment",
        "untestable",
        "missing",
        "misfits",
        "nearest",
        "gap",
        "minimum_detectable",
        "log_faults",
    }
    assert data["effects"][0]["params"]["knee"] == {
        "value": 14.2,
        "ci90": [13.6, 14.9],
        "unit": "Nm",
    }
    assert data["gap"]["closed"] == pytest.approx(0.75)


@pytest.mark.parametrize(
    ("rulings", "merged"),
    [
        (("no_gap", "no_gap"), "no_gap"),
        (("named", "no_gap"), "named"),
        (("named", "set"), "set"),
        (("unexplained", "set"), "unexplained"),
        ((), "no_gap"),
    ],
)
def test_the_least_sure_part_rules(rulings: tuple[ProblemRuling, ...], merged: str) -> None:
    assert (
        merge_findings([findings(f"p{i}", ruling) for i, ruling in enumerate(rulings)]).verdict
        == merged
    )


def test_a_damaged_log_is_judged_by_nothing_else() -> None:
    verdict = merge_findings([findings("joints", "named", effects=(EFFECT,))], ["t runs backwards"])
    assert verdict == Verdict(verdict="bad_log", log_faults=("t runs backwards",))


def test_the_gap_is_that_of_sensors_that_show_one() -> None:
    verdict = merge_findings(
        [findings("joints", "named", effects=(EFFECT,)), findings("imu", "no_gap")]
    )
    assert verdict.gap == ResidualGap(before=5.0, after=1.5, floor=1.0)
