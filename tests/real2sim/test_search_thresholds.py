"""Thresholds of the search: chance, correct simulators that differ, and what they may leave, get no name."""

from dataclasses import replace

import numpy as np
import pytest
from effect_sizes import sizes
from linear_problem import WHERES, LinearProblem
from scipy.ndimage import gaussian_filter1d

from benchmarks.left_out import NarrowedProblem
from saltus.real2sim.search.decide import (
    REMAINDER_RMS,
)
from saltus.real2sim.search.search import search_effects


@pytest.mark.parametrize(
    ("resolution", "verdict"), [(0.0, "named"), (0.5, "named"), (5.0, "unexplained")]
)
def test_an_effect_is_named_only_beyond_what_two_correct_simulators_differ_by(
    resolution: float, verdict: str
) -> None:
    problem = LinearProblem(sizes("e1", 3.0))
    problem.candidates = tuple(replace(each, resolution=resolution) for each in problem.candidates)
    findings = search_effects(problem)
    assert (findings.verdict, bool(findings.effects)) == (verdict, verdict == "named")


MANY = tuple(f"leg {number}" for number in range(24))
LITTLE = 0.3


def little(
    seed: int, resolution: float, alike: float | None = None, beside: float = 0.0
) -> LinearProblem:
    """Many legs whose effect no segment and signal shows with 0.45 sigma; all together do.

    They have the effect e4 of the size `beside`, too.
    """
    hidden = {
        (effect, where, block): size
        for effect, size in (("e1", LITTLE), ("e4", beside))
        for where in WHERES
        for block in MANY
    }
    problem = LinearProblem(hidden, seed=seed, blocks=MANY, alike=alike)
    problem.candidates = tuple(replace(c, resolution=resolution) for c in problem.candidates)
    return problem


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("resolution", "verdict"), [(0.0, "no_gap"), (0.03, "named"), (0.15, "no_gap")]
)
def test_what_shows_little_is_named_where_its_value_is_more_than_simulators_differ_by(
    resolution: float, verdict: str, seed: int
) -> None:
    findings = search_effects(little(seed, resolution))
    assert findings.verdict == verdict
    assert {effect.name for effect in findings.effects} <= {"e1"}
    assert (findings.minimum_detectable["e1"].value < LITTLE) == (verdict == "named")


@pytest.mark.parametrize("beside", [3.0, 12.0])
@pytest.mark.parametrize(
    ("resolution", "names"),
    # With 0.08 the largest of the values counts, but not what all places share
    [(0.0, {"e4"}), (0.03, {"e1", "e4"}), (0.08, {"e4"}), (0.15, {"e4"})],
)
def test_what_shows_little_beside_an_effect_is_named_where_its_value_counts(
    resolution: float, names: set[str], beside: float
) -> None:
    findings = search_effects(little(0, resolution, beside=beside))
    assert (findings.verdict, {effect.name for effect in findings.effects}) == ("named", names)


@pytest.mark.parametrize("seed", range(4))
def test_what_takes_a_part_of_what_shows_little_has_no_name_beside_an_effect(
    seed: int,
) -> None:
    findings = search_effects(NarrowedProblem(little(seed, 0.01, alike=0.65, beside=3.0), ["e1"]))
    assert {effect.name for effect in findings.effects} == {"e4"}


@pytest.mark.parametrize("seed", range(4))
def test_what_shows_little_has_no_name_of_what_takes_less_than_half_of_it(seed: int) -> None:
    problem = little(seed, 0.01, alike=0.65)
    assert search_effects(problem).verdict in ("named", "set")
    assert search_effects(NarrowedProblem(problem, ["e1"])).verdict == "no_gap"


@pytest.mark.parametrize(("closable", "names"), [(1.0, {"e1", "e2"}), (0.9, {"e1"})])
def test_no_further_effect_explains_a_part_of_what_may_be_chance(
    closable: float, names: set[str]
) -> None:
    problem = LinearProblem(sizes("e1", 12.0) | sizes("e2", 2.0) | sizes("e5", 2.0))
    problem.candidates = tuple(replace(c, closable_share=closable) for c in problem.candidates)
    findings = search_effects(NarrowedProblem(problem, ["e5"]))
    assert {effect.name for effect in findings.effects} == names


@pytest.mark.parametrize(
    ("least", "verdict"), [(0.0, "named"), (0.75, "named"), (0.95, "unexplained")]
)
def test_an_effect_that_alone_closes_too_little_and_leaves_a_gap_is_not_named(
    least: float, verdict: str
) -> None:
    problem = LinearProblem(sizes("e1", 8.0) | sizes("e5", 3.5))
    problem.candidates = tuple(replace(c, least_closed=least) for c in problem.candidates)
    assert search_effects(NarrowedProblem(problem, ["e5"])).verdict == verdict


@pytest.mark.sample(2)
@pytest.mark.parametrize("disagreement", [1.0, 0.2])
@pytest.mark.parametrize("seed", range(4))
def test_simulators_that_agree_leave_no_more_beside_the_effect_that_is_named(
    seed: int, disagreement: float
) -> None:
    """One remainder is no gap between simulators that differ much, and a gap between others."""
    problem = LinearProblem(sizes("e1", 2.0) | sizes("e5", 0.85), seed=seed)
    problem.candidates = tuple(replace(c, least_closed=0.97) for c in problem.candidates)
    problem.simulator_disagreement = disagreement
    findings = search_effects(NarrowedProblem(problem, ["e5"]))
    assert (findings.verdict == "named") == (findings.remainder < disagreement * REMAINDER_RMS)


def with_chance(problem: LinearProblem, rms: float, seed: int) -> LinearProblem:
    """The problem with what is another at every repeat, as slow as its effects."""
    rows = np.random.default_rng(seed).normal(size=problem.measured.shape)
    slow = gaussian_filter1d(rows, 5.0, axis=-1)
    problem.measured = problem.measured + rms * slow / slow.std()
    return problem


@pytest.mark.sample(2)
@pytest.mark.parametrize("seed", range(4))
def test_what_differs_from_repeat_to_repeat_may_be_left_by_an_effect_of_chance(seed: int) -> None:
    rms = np.random.default_rng(seed).uniform(1.5, 2.0)
    for leaves_chance, verdict in ((False, "unexplained"), (True, "named")):
        problem = with_chance(LinearProblem(sizes("e1", 6.0), seed=seed), rms, seed)
        problem.candidates = tuple(
            replace(c, leaves_chance=leaves_chance, least_closed=0.9) for c in problem.candidates
        )
        findings = search_effects(problem)
        assert findings.verdict == verdict
        assert {each.name for each in findings.effects} == ({"e1"} if leaves_chance else set())


@pytest.mark.sample(2)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("left", ["the same at every repeat", "nothing but chance"])
def test_no_effect_of_chance_explains_what_repeats_or_chance_alone(left: str, seed: int) -> None:
    problem = LinearProblem(
        sizes("e1", 6.0) | sizes("e5", 3.0) if left.startswith("the same") else {}, seed=seed
    )
    if left == "nothing but chance":
        problem = with_chance(problem, 3.0, seed)
    problem.candidates = tuple(
        replace(c, leaves_chance=True, least_closed=0.9) for c in problem.candidates
    )
    assert search_effects(NarrowedProblem(problem, ["e5"])).verdict == "unexplained"


@pytest.mark.parametrize(
    ("resolution", "names"), [(0.0, ("e1", "e2")), (0.5, ("e1", "e2")), (5.0, ("e1",))]
)
def test_a_further_effect_is_larger_than_what_two_correct_simulators_differ_by(
    resolution: float, names: tuple[str, ...]
) -> None:
    problem = LinearProblem(sizes("e1", 8.0) | sizes("e2", 2.5))
    problem.candidates = tuple(replace(c, resolution=resolution) for c in problem.candidates)
    findings = search_effects(problem)
    assert findings.residuals is not None
    assert findings.residuals.effects == names


@pytest.mark.parametrize("level", [1.0, 1.08])
def test_noise_that_lasts_and_is_a_little_larger_than_its_estimate_is_no_gap(level: float) -> None:
    for seed in range(5):
        problem = LinearProblem({}, seed=seed, colour=0.6)
        problem.measured = level * problem.measured
        assert search_effects(problem).verdict == "no_gap"


@pytest.mark.parametrize(
    ("amplitude", "signals", "segments", "verdict"),
    [
        (1.35, 1, (0,), "no_gap"),
        (1.35, 2, (0,), "no_gap"),  # segment 1 is its repeat: a foot rests otherwise once
        (1.35, 2, (0, 1), "unexplained"),
        (1.35, 2, (0, 3), "unexplained"),
        (2.5, 1, (0,), "unexplained"),
    ],
)
def test_a_weak_gap_shows_in_more_than_one_segment(
    amplitude: float, signals: int, segments: tuple[int, ...], verdict: str
) -> None:
    for seed in range(4):
        problem = LinearProblem({}, seed=seed)
        shown = np.isin(problem.segment, segments) & (problem.signal < signals)
        wave = amplitude * np.sin(2.0 * np.pi * 7.0 * problem.time_s[shown])
        problem.measured[0, shown] += wave
        assert search_effects(problem).verdict == verdict
