"""A library that lacks the true effect: the search says that it does not know,
and names nothing else.
"""

import itertools

import numpy as np
import pytest
from linear_problem import WHERES, LinearProblem

from benchmarks.left_out import NarrowedProblem
from saltus.real2sim.search.search import search_effects

BLOCKS = ("FR", "FL")


@pytest.mark.parametrize("effect", [f"e{i}" for i in range(6)])
def test_the_true_effect_left_out_is_unexplained(effect: str) -> None:
    inner = LinearProblem(
        {(effect, *place): 3.0 for place in itertools.product(WHERES, BLOCKS)}, seed=3, colour=0.3
    )
    assert [found.name for found in search_effects(inner).effects] == [effect]
    narrowed = NarrowedProblem(inner, (effect,))
    assert {c.effect for c in narrowed.candidates} == {c.effect for c in inner.candidates} - {
        effect
    }
    findings = search_effects(narrowed)
    assert findings.verdict == "unexplained"
    assert not findings.effects


def test_the_other_unknowns_do_what_they_did() -> None:
    inner = LinearProblem({}, seed=4)
    narrowed = NarrowedProblem(inner, ("e1", "e4"))
    rng = np.random.default_rng(5)
    full = rng.uniform(0.0, 2.0, (3, len(BLOCKS), len(inner.candidates)))
    left_out = np.array([c.effect in ("e1", "e4") for c in inner.candidates])
    full[..., left_out] = 0.0
    np.testing.assert_array_equal(narrowed.residuals(full[..., ~left_out]), inner.residuals(full))
