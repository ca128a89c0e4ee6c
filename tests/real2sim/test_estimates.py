"""One value for all places, or one for each kind of place,
as the data have it, and its interval.
"""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from linear_problem import WHERES, LinearProblem

from saltus.real2sim.search.findings import ParameterInterval
from saltus.real2sim.search.search import search_effects

BLOCKS = ("FR", "FL", "RR", "RL")


@pytest.mark.parametrize(("hip", "thigh"), [(3.0, 6.0), (7.0, 4.0)])
def test_kinds_of_joints_that_differ_are_stated_apart(hip: float, thigh: float) -> None:
    size = {"hip": hip, "thigh": thigh}
    hidden = {
        ("e4", where, block): size[where] for where, block in itertools.product(WHERES, BLOCKS)
    }
    findings = search_effects(LinearProblem(hidden, blocks=BLOCKS))
    found = {effect.where: effect.params["size"].value for effect in findings.effects}
    places = {where: tuple(f"{block}_{where}" for block in BLOCKS) for where in WHERES}
    assert found == {places[where]: pytest.approx(size[where], rel=0.1) for where in WHERES}


def test_kinds_of_joints_that_agree_are_stated_as_all() -> None:
    hidden = {("e2", where, block): 4.0 for where, block in itertools.product(WHERES, BLOCKS)}
    (effect,) = search_effects(LinearProblem(hidden, blocks=BLOCKS)).effects
    assert effect.where == "all"


SIZE = 4.0


def interval_of_another_shape(misfit: float, seed: int) -> ParameterInterval:
    """Interval of an effect that differs from its model by this share of its RMS,
    in a random direction.
    """
    everywhere = {("e0", where, block): SIZE for where, block in itertools.product(WHERES, BLOCKS)}
    problem, noise = (
        LinearProblem(hidden, seed=seed, blocks=BLOCKS, effects=1) for hidden in (everywhere, {})
    )
    rng = np.random.default_rng(seed)
    own = problem.measured - noise.measured
    time_s = problem.time_s % 2.0  # every segment has the same motion
    wave = np.sin(2.0 * np.pi * rng.uniform(0.5, 4.0) * time_s + rng.uniform(0.0, 6.3))
    wave -= own[0] * (wave @ own[0]) / (own[0] @ own[0])
    along = 0.6 * rng.uniform(-1.0, 1.0)  # a third (RMS) of what lies beside it
    other = wave / np.sqrt(np.mean(wave**2)) * np.sqrt(np.mean(own**2)) + along * own[0]
    problem.measured = problem.measured + misfit * other
    (found,) = search_effects(problem).effects
    assert found.where == "all"
    return found.params["size"]


@pytest.mark.sample(1)
@pytest.mark.parametrize("misfit", [0.0, 0.1, 0.3])
def test_intervals_hold_the_size_of_an_effect_of_another_shape(misfit: float) -> None:
    found = [interval_of_another_shape(misfit, seed) for seed in range(12)]
    held = [each.ci90[0] <= SIZE <= each.ci90[1] for each in found]
    widths = [(each.ci90[1] - each.ci90[0]) / SIZE for each in found]
    assert np.mean(held) >= 0.75  # of 90 %, in 12 draws
    # no wider than asked for by noise and correct models, and by a third of what is left
    assert np.median(widths) <= 2.0 * 1.645 * 1.3 * np.hypot(0.03, misfit / 3.0)


class VectorProblem(LinearProblem):
    """One effect with two sizes, x ten times y."""

    def __init__(self) -> None:
        places = list(itertools.product(WHERES, BLOCKS))
        hidden = {("e0", *place): 40.0 for place in places} | {("e1", *p): 4.0 for p in places}
        super().__init__(hidden, effects=2, blocks=BLOCKS)
        size = self.candidates[0].unknowns[0]
        both = (replace(size, name="x"), replace(size, name="y"))
        self.candidates = (
            *(replace(c, unknowns=both, starts=((0.5, 0.5),)) for c in self.candidates[:2]),
            self.candidates[-1],
        )
        self._signatures = self._signatures[[0, 2, 1, 3, 4]]


def test_a_small_component_is_no_less_certain_beside_a_large_one() -> None:
    (effect,) = search_effects(VectorProblem()).effects
    for name, size in (("x", 40.0), ("y", 4.0)):
        low, high = effect.params[name].ci90
        assert low <= size <= high
        assert high - low <= 2.0 * 1.645 * 1.3 * 0.03 * size
