"""Logs of different claims as one problem, and what several findings decide together."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from linear_problem import WHERES, LinearProblem

from saltus.real2sim.problem.problem import ParameterEstimate, UnknownCoordinates
from saltus.real2sim.search.findings import (
    FoundEffect,
    ParameterInterval,
    SearchFindings,
    SignalGap,
)
from saltus.real2sim.search.search import search_effects
from saltus.real2sim.stacked_problem import StackedProblem, can_stack
from saltus.real2sim.verdict import without_ruled_out

HIDDEN = {("e1", where, block): 3.0 for where, block in itertools.product(WHERES, ("FR", "FL"))}
LATER_S = 20.0


class Offset(LinearProblem):
    """Counts its unknowns from another claim."""

    def __init__(self, hidden: dict[tuple[str, str, str], float]) -> None:
        super().__init__(hidden)
        later = UnknownCoordinates.less("size", 1.0)
        self.candidates = tuple(
            replace(candidate, coordinates=later) for candidate in self.candidates
        )


@pytest.fixture(scope="module")
def logs() -> tuple[LinearProblem, LinearProblem]:
    """In the first two effects look alike, in the second they do not."""
    return LinearProblem(HIDDEN, alike=0.995), LinearProblem(HIDDEN, alike=0.3, seed=1)


def test_two_logs_tell_what_one_cannot(logs: tuple[LinearProblem, LinearProblem]) -> None:
    alone = search_effects(logs[0])
    assert (alone.verdict, alone.sets) == ("set", (("e1", "e2"),))
    assert {rival.name for rival in alone.rivals} == {"e1", "e2"}
    together = search_effects(StackedProblem(logs, (0.0, LATER_S)))
    assert together.verdict == "named"
    assert [(effect.name, effect.where) for effect in together.effects] == [("e1", "all")]
    assert together.effects[0].params["size"].value == pytest.approx(3.0, rel=0.1)


def test_effects_are_shared_and_nuisances_are_not(
    logs: tuple[LinearProblem, LinearProblem],
) -> None:
    stacked = StackedProblem(logs, (0.0, LATER_S))
    names = [candidate.effect for candidate in stacked.candidates if candidate.is_nuisance]
    assert names == ["clock of log 1", "clock of log 2"]
    assert len(stacked.candidates) == len(logs[0].candidates) + 1
    rows, blocks = len(logs[0].time_s), len(stacked.blocks)
    nothing = np.zeros((1, blocks, len(stacked.candidates)))
    base = stacked.residuals(nothing)
    for column, candidate in enumerate(stacked.candidates):
        unknowns = nothing.copy()
        unknowns[..., column] = 1.0
        moved = np.any(stacked.residuals(unknowns) != base, axis=(0, 1))
        seen = [bool(moved[:rows].any()), bool(moved[rows:].any())]
        assert seen == (
            [f"of log {n}" in candidate.effect for n in (1, 2)]
            if candidate.is_nuisance
            else [True, True]
        )
    assert np.all(np.diff(stacked.time_s.reshape(4, -1), axis=1) >= 0.0)
    assert stacked.segments[-1].end_s == pytest.approx(logs[1].segments[-1].end_s + LATER_S)
    assert len({segment.condition for segment in stacked.segments}) == 6


def test_only_what_means_the_same_is_shared(logs: tuple[LinearProblem, LinearProblem]) -> None:
    assert can_stack(logs)
    assert not can_stack([logs[0], Offset(HIDDEN)])
    assert not can_stack([logs[0], LinearProblem({}, blocks=("FR",))])


def found(name: str, **values: float) -> FoundEffect:
    return FoundEffect(
        name=name,
        where="all",
        params={k: ParameterInterval(value=v, ci90=(v, v), unit="") for k, v in values.items()},
    )


UNSURE = SearchFindings(
    problem="body", verdict="set", sets=(("payload_mass", "torque_gain"),),
    rivals=(found("payload_mass", mass=0.4), found("torque_gain", gain=0.967)),
    gaps=(SignalGap(signal="q", residuals=100, before=5.0, after=1.0, floor=1.0),),
)  # fmt: skip


@pytest.mark.parametrize(
    ("gain", "verdict", "names"),
    [(1.02, "named", ["payload_mass"]), (1.03, "set", []), (0.9, "set", [])],
)
def test_an_effect_that_another_sensor_would_have_shown_is_ruled_out(
    gain: float, verdict: str, names: list[str]
) -> None:
    sizes = {"torque_gain": ParameterEstimate(value=gain, unit="")}
    held = SearchFindings(problem="joints", verdict="no_gap", minimum_detectable=sizes)
    body, joints = without_ruled_out((UNSURE, held))
    assert (body.verdict, [effect.name for effect in body.effects]) == (verdict, names)
    assert joints.verdict == "no_gap"


def test_who_has_a_gap_of_its_own_rules_nothing_out() -> None:
    sizes = {"torque_gain": ParameterEstimate(value=1.001, unit="")}
    lost = SearchFindings(problem="joints", verdict="unexplained", minimum_detectable=sizes)
    assert without_ruled_out((UNSURE, lost))[0].verdict == "set"


def test_evidence_of_two_logs_decides_between_effects_that_are_alike_in_both() -> None:
    both = [LinearProblem(HIDDEN, alike=0.97, seed=seed) for seed in (0, 1)]
    assert [search_effects(one).verdict for one in both] == ["set", "set"]
    together = search_effects(StackedProblem(both, (0.0, LATER_S)))
    assert (together.verdict, [effect.name for effect in together.effects]) == ("named", ["e1"])
    same = [LinearProblem(HIDDEN, alike=0.9999, seed=seed) for seed in (0, 1)]
    assert search_effects(StackedProblem(same, (0.0, LATER_S))).sets == (("e1", "e2"),)
