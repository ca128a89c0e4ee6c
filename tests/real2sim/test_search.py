import itertools
from dataclasses import replace

import numpy as np
import pytest
from effect_sizes import BLOCKS, sizes
from linear_problem import ChoiceProblem, LinearProblem
from one_joint import WHERES as JOINTS
from one_joint import OneJoint

from benchmarks.left_out import NarrowedProblem
from saltus.real2sim.search import model_fit
from saltus.real2sim.search.choose import choose, choose_among
from saltus.real2sim.search.decide import (
    SIZE_RMS,
    ModelComparison,
    ScoredFit,
    dispersion_of,
)
from saltus.real2sim.search.residual_split import ResidualCells
from saltus.real2sim.search.search import _Search, search_effects
from saltus.real2sim.search.unknowns_layout import ModelEffects, UnknownsLayout, with_effects


def everywhere(effect: str, *values: float) -> dict[tuple[str, str, str], tuple[float, ...]]:
    return {(effect, where, block): values for where, block in itertools.product(JOINTS, BLOCKS)}


@pytest.mark.parametrize("colour", [0.0, 0.5])
def test_noise_alone_is_no_gap(colour: float) -> None:
    rulings = [
        search_effects(LinearProblem({}, seed=seed, colour=colour)).verdict for seed in range(12)
    ]
    assert rulings.count("no_gap") == len(rulings)


def test_every_effect_of_a_linear_problem_is_named() -> None:
    for i in range(6):
        findings = search_effects(LinearProblem(sizes(f"e{i}", 2.5), seed=i, colour=0.3))
        assert findings.verdict == "named"
        assert [(effect.name, effect.where) for effect in findings.effects] == [(f"e{i}", "all")]


def test_intervals_hold_the_truth() -> None:
    held = []
    for seed in range(12):
        findings = search_effects(
            LinearProblem(sizes("e3", 3.5) | sizes("e5", 3.0), seed=seed, colour=0.4)
        )
        found = {effect.name: effect.params["size"].ci90 for effect in findings.effects}
        held += [
            found[name][0] <= size <= found[name][1] for name, size in (("e3", 3.5), ("e5", 3.0))
        ]
    assert np.mean(held) >= 0.8


@pytest.mark.parametrize(
    ("where", "block", "place"),
    [("hip", "FL", "FL_hip"), ("thigh", "FR", "FR_thigh"), ("thigh", "FL", "FL_thigh")],
)
def test_an_effect_at_one_place_is_found_there(where: str, block: str, place: str) -> None:
    findings = search_effects(LinearProblem({("e4", where, block): 3.0}))
    assert [(effect.name, effect.where) for effect in findings.effects] == [("e4", (place,))]


def test_effects_of_different_size_are_told_place_by_place() -> None:
    findings = search_effects(LinearProblem({("e4", "hip", "FR"): 6.0, ("e4", "thigh", "FL"): 3.0}))
    found = {effect.where: effect.params["size"].value for effect in findings.effects}
    assert found == {
        ("FR_hip",): pytest.approx(6.0, rel=0.1),
        ("FL_thigh",): pytest.approx(3.0, rel=0.1),
    }


@pytest.mark.parametrize(("alike", "verdict"), [(0.98, "set"), (0.8, "named")])
def test_collinear_effects_are_a_set(alike: float, verdict: str) -> None:
    findings = search_effects(LinearProblem(sizes("e1", 3.0), alike=alike))
    assert findings.verdict == verdict
    assert findings.sets == ((("e1", "e2"),) if verdict == "set" else ())
    assert findings.confusion.between("e1", "e2") == pytest.approx(alike, abs=0.03)


@pytest.mark.parametrize("effect", ["e0", "e1", "e3", "e5"])
def test_the_smallest_detectable_effect_is_at_the_edge_of_detection(effect: str) -> None:
    """Whatever signals and segments show it."""
    smallest = search_effects(LinearProblem({})).minimum_detectable[effect].value
    for share, verdict in ((1.5, "named"), (0.7, "no_gap")):
        hidden = {(effect, "hip", "FR"): share * smallest}
        assert search_effects(LinearProblem(hidden)).verdict == verdict


SINGLES = {
    "command_delay": (0.004,),
    "actuator_lag": (0.006,),
    "viscous_friction": (0.1,),
    "coulomb_friction": (0.25,),
    "torque_saturation": (0.3, 7.0),
}


@pytest.mark.sample(3)
@pytest.mark.parametrize("effect", SINGLES)
def test_effects_of_a_joint_are_named_with_their_size(effect: str) -> None:
    findings = search_effects(OneJoint(everywhere(effect, *SINGLES[effect]), colour=0.4))
    assert [(found.name, found.where) for found in findings.effects] == [(effect, "all")]
    values = [interval.value for interval in findings.effects[0].params.values()]
    assert values == pytest.approx(SINGLES[effect], rel=0.05)
    after, floor = (sum(getattr(gap, name) for gap in findings.gaps) for name in ("after", "floor"))
    assert after == pytest.approx(floor, rel=0.1)


@pytest.mark.sample(1)
@pytest.mark.parametrize("effect", ["torque_gain", "armature"])
def test_gain_and_inertia_cannot_be_told_apart(effect: str) -> None:
    size = {"torque_gain": -0.1, "armature": 0.003}[effect]
    assert search_effects(OneJoint(everywhere(effect, size), colour=0.4)).sets == (
        ("armature", "torque_gain"),
    )


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("first", "second"),
    [
        (("command_delay", 0.006), ("viscous_friction", 0.1)),
        (("command_delay", 0.005), ("actuator_lag", 0.005)),
    ],
)
def test_pairs_are_named_though_one_hides_the_other(
    first: tuple[str, float], second: tuple[str, float]
) -> None:
    findings = search_effects(OneJoint(everywhere(*first) | everywhere(*second), colour=0.4))
    named = {effect.name for effect in findings.effects} | {
        name for names in findings.sets for name in names
    }
    assert named == {first[0], second[0]}


@pytest.mark.sample(1)
@pytest.mark.parametrize("seed", [0, 1])
def test_curves_that_differ_from_leg_to_leg_are_stated_so_that_they_explain_the_log(
    seed: int,
) -> None:
    shapes = {
        ("hip", "FR"): (0.25, 4.0),
        ("calf", "FR"): (0.3, 8.0),
        ("hip", "FL"): (0.3, 7.0),
        ("calf", "FL"): (0.2, 5.0),
    }
    hidden = {
        ("torque_saturation", where, block): values for (where, block), values in shapes.items()
    }
    findings = search_effects(
        OneJoint(hidden | everywhere("viscous_friction", 0.15), seed=seed, colour=0.4)
    )
    assert findings.verdict == "named"
    assert {found.name for found in findings.effects} == {"torque_saturation", "viscous_friction"}
    after, floor = (sum(getattr(gap, name) for gap in findings.gaps) for name in ("after", "floor"))
    assert after == pytest.approx(floor, rel=0.1)


def test_three_effects_are_found_though_a_delay_stands_in_for_two_of_them() -> None:
    hidden = (
        everywhere("armature", 0.006)
        | everywhere("viscous_friction", 0.1)
        | everywhere("coulomb_friction", 0.25)
    )
    findings = search_effects(OneJoint(hidden))
    named = {found.name for found in findings.effects} | {
        name for names in findings.sets for name in names
    }
    assert {"armature", "viscous_friction", "coulomb_friction"} <= named
    assert not named & {"command_delay", "actuator_lag", "torque_saturation"}


def test_a_small_effect_beside_a_far_larger_one_is_named() -> None:
    findings = search_effects(
        OneJoint(everywhere("torque_saturation", 0.6, 4.0) | everywhere("viscous_friction", 0.02))
    )
    assert {found.name for found in findings.effects} == {"torque_saturation", "viscous_friction"}


@pytest.mark.parametrize("is_apart", [True, False])
def test_an_effect_with_residuals_of_its_own_gains_by_its_own_scatter(is_apart: bool) -> None:
    """As lost images beside a temporal filter, whose depths scatter far more than noise."""
    problem = LinearProblem({("e1", "hip", "FR"): 6.0, ("e5", "thigh", "FR"): 3.0})
    if is_apart:
        problem.part_signals()
    problem.candidates = tuple(
        replace(c, effect=f"{c.effect} of a thigh") if c.where == "thigh" else c
        for c in problem.candidates
    )
    layout, evaluate = UnknownsLayout.of(problem), model_fit.ProblemEvaluator(problem)
    null, split = model_fit.fitted_null(problem, evaluate, layout)
    comparison = ModelComparison(
        layout=layout,
        split=split,
        cells=ResidualCells.of(problem, split.is_fit),
        rng=np.random.default_rng(0),
        size=SIZE_RMS,
    )

    def scored(model: ModelEffects) -> ScoredFit:
        start = model_fit.begun(evaluate, layout, model, layout.of_model(model), null.unknowns, "")
        fits = model_fit.refine_fits(evaluate, layout, split, [start], stage="")
        return comparison.score(model_fit.renew_derivatives(evaluate, layout, fits, "")[0])

    held, rival = scored(("e1",)), scored(("e1", "e5 of a thigh"))
    found = dispersion_of(comparison, held, rival, 300.0)
    assert found < 3.0 if is_apart else found == 300.0


@pytest.mark.parametrize("large", [3.0, 8.0])
@pytest.mark.parametrize("side", ["e1", "e6"])
def test_a_choice_that_looks_worse_alone_is_made_beside_another_effect(
    large: float, side: str
) -> None:
    findings = search_effects(ChoiceProblem(sizes("e2", large) | sizes(side, 3.0), alike=0.9))
    assert findings.verdict == "named"
    found = {effect.name: effect.params for effect in findings.effects}
    assert found.keys() == {"e1", "e2"}
    assert found["e1"]["side"].value == (side == "e6")


def test_what_is_not_in_the_library_stays_unexplained() -> None:
    assert search_effects(OneJoint({}, ripple=0.3, colour=0.4)).verdict == "unexplained"


@pytest.mark.sample(1)
@pytest.mark.parametrize("effect", ["command_delay", "coulomb_friction"])
def test_without_the_true_effect_no_other_is_named(effect: str) -> None:
    findings = search_effects(
        OneJoint(everywhere(effect, *SINGLES[effect]), colour=0.4, without=(effect,))
    )
    assert findings.verdict == "unexplained"
    assert not findings.effects
    assert not findings.sets
    chosen = findings.residuals.effects if findings.residuals else ()
    assert {each.name for each in findings.nearest} == set(chosen)


def test_a_problem_without_candidates_has_no_names() -> None:
    problem = LinearProblem({}, effects=0)
    assert search_effects(problem).verdict == "no_gap"


def test_a_gap_without_candidates_is_unexplained() -> None:
    problem = LinearProblem(sizes("e3", 3.0))
    problem.candidates = problem.candidates[-1:]
    problem.keep_unknowns(slice(-1, None))
    assert search_effects(problem).verdict == "unexplained"


def test_a_problem_without_residuals_has_no_gap() -> None:
    problem = LinearProblem(sizes("e3", 3.0))
    problem.keep_rows(slice(0, 0))
    assert search_effects(problem).verdict == "no_gap"


def test_a_segment_too_short_to_test_by_names_nothing_however_large_its_effect() -> None:
    problem = LinearProblem({("e0", "hip", "FR"): 5.0})
    problem.keep_rows(np.flatnonzero(problem.time_s < 1.2))
    findings = search_effects(problem)
    assert (findings.verdict, findings.effects, findings.sets, findings.gaps) == (
        "unexplained",
        (),
        (),
        (),
    )
    assert [effect.name for effect in findings.nearest] == ["e0"]


class TrappedProblem(LinearProblem):
    """A clock of two minima: from none, slopes lead to the worse one."""

    def __init__(self, beside: dict[tuple[str, str, str], float] | None = None) -> None:
        clock = {("clock", "hip", block): 6.0 for block in BLOCKS}
        super().__init__(sizes("e1", 8.0) | clock | (beside or {}))
        *effects, last = self.candidates
        unknown = replace(last.unknowns[0], low=-0.5)
        self.candidates = (*effects, replace(last, unknowns=(unknown,)))

    def residuals(self, unknowns: np.ndarray) -> np.ndarray:
        clock = unknowns[..., -1:]
        return super().residuals(np.concatenate([unknowns[..., :-1], clock**2 - clock], axis=-1))


def test_a_model_takes_the_nuisances_that_a_larger_one_has_found() -> None:
    searched = _Search(TrappedProblem(), None, 0)
    searched.run()
    known, layout = searched._known, searched._layout
    assert known.fits[("e1",)].unknowns[:, -1] == pytest.approx(-0.5)
    unknowns = known.fits[("e1",)].unknowns.copy()
    unknowns[:, -1] = 3.0
    larger: ModelEffects = ("e1", "e2")
    known.fits[larger] = model_fit.begun(
        searched._evaluate, layout, larger, layout.of_model(larger), unknowns, "test"
    )
    searched._refit_rivals()
    assert known.fits[("e1",)].unknowns[:, -1] == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize("extra", ["e0", "e3", "e4", "e5"])
def test_no_effect_is_chosen_for_what_the_others_lack_of_a_good_fit(extra: str) -> None:
    """Also where the others fit worse so far than several models of their size."""
    searched = _Search(TrappedProblem(sizes("e2", 1.3)), None, 0)
    searched.run()
    known, layout = searched._known, searched._layout
    others = [with_effects(["e1", other]) for other in ("e0", "e3", "e4", "e5")]
    larger = with_effects(["e1", "e2", extra])
    for model in (("e1", "e2"), larger, *others):
        unknowns = known.fits[("e1",)].unknowns.copy()
        unknowns[:, -1] = -0.5 if model == ("e1", "e2") else 3.0
        known.fits[model] = model_fit.begun(
            searched._evaluate, layout, model, layout.of_model(model), unknowns, "test"
        )
    searched._refit([("e1", "e2"), larger, *others], "test")
    assert known.cost(known.fits[("e1", "e2")]) > max(known.cost(known.fits[m]) for m in others)
    searched._refit_rivals()
    assert known.fits[("e1", "e2")].unknowns[:, -1] == pytest.approx(3.0, abs=0.1)
    assert choose_among(searched._comparison, known.fits.values()).chosen.fit.model == ("e1", "e2")


@pytest.mark.parametrize("extra", ["e0", "e3", "e4"])
def test_each_effect_of_a_model_explains_what_its_others_leave(extra: str) -> None:
    """One that only costs less and shows explains nothing, whatever models come before the true
    one: dry friction quiets a drive that hunts between two steps of its encoder.
    """
    hidden = sizes("e1", 8.0) | sizes("e2", 4.0) | sizes("e5", 1.5)
    searched = _Search(NarrowedProblem(LinearProblem(hidden), ["e5"]), None, 0)
    searched.run()
    fits, comparison = searched._known.fits, searched._comparison
    alone, true = (comparison.score(fits[model]) for model in (("e1",), ("e1", "e2")))
    hunt = LinearProblem({}, seed=1).measured - LinearProblem({}).measured

    def cheaper(like: ScoredFit, *model: str) -> ScoredFit:
        fit = replace(like.fit, model=with_effects(model), residuals=like.fit.residuals + hunt)
        structure = comparison.cells.structure(fit.residuals)
        return ScoredFit(fit=fit, held_out=0.5 * true.held_out, structure=structure)

    false = [cheaper(alone, "e1", effect) for effect in ("e0", "e3", "e4")]
    larger = cheaper(true, "e1", "e2", extra)
    scored = [comparison.score(fits[()]), alone, true, *false, larger]
    assert choose(comparison, scored, 1.0).fit.model == ("e1", "e2")
