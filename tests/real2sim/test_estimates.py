"""One value for all places, or one for each kind of place, as the data have it."""

import itertools

import pytest
from linear_problem import WHERES, LinearProblem

from saltus.real2sim.search.search import search

BLOCKS = ("FR", "FL", "RR", "RL")


@pytest.mark.parametrize(("hip", "thigh"), [(3.0, 6.0), (7.0, 4.0)])
def test_kinds_of_joints_that_differ_are_stated_apart(hip: float, thigh: float) -> None:
    size = {"hip": hip, "thigh": thigh}
    hidden = {
        ("e4", where, block): size[where] for where, block in itertools.product(WHERES, BLOCKS)
    }
    findings = search(LinearProblem(hidden, blocks=BLOCKS))
    found = {effect.where: effect.params["size"].value for effect in findings.effects}
    places = {where: tuple(f"{block}_{where}" for block in BLOCKS) for where in WHERES}
    assert found == {places[where]: pytest.approx(size[where], rel=0.1) for where in WHERES}


def test_kinds_of_joints_that_agree_are_stated_as_all() -> None:
    hidden = {("e2", where, block): 4.0 for where, block in itertools.product(WHERES, BLOCKS)}
    (effect,) = search(LinearProblem(hidden, blocks=BLOCKS)).effects
    assert effect.where == "all"
