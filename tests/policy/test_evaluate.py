"""Evaluation and search: what they report, with short trials."""

from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

from saltus.config import TerrainConfig, from_toml, to_toml
from saltus.errors import ConfigError
from saltus.policy.evaluation.evaluate import Evaluation, collect, courses_of, evaluate
from saltus.policy.evaluation.rollout import exact_heights
from saltus.policy.evaluation.search import BOUNDS, FIRST_SEARCH_SEED, SearchConfig, search
from saltus.policy.scripted import ScriptedParameters
from saltus.trial import Trial

FLAT = TerrainConfig(terrain="flat")


def test_outcomes_come_back_by_seed_and_do_not_depend_on_the_batch() -> None:
    evaluation = Evaluation(course=FLAT, trials=3, first_seed=7, time_limit_s=1.2)
    together = collect(evaluate(evaluation, exact_heights, processes=1))
    assert together.seeds == (7, 8, 9)
    assert together.successes == 0
    assert together.failures == {"timeout": 3}
    assert np.isnan(together.mean_speed_mps)
    alone = collect(evaluate(Evaluation(course=FLAT, trials=1, first_seed=8, time_limit_s=1.2), exact_heights))
    for name, value in asdict(alone.outcomes[0]).items():
        assert asdict(together.outcomes[1])[name] == pytest.approx(value, abs=1e-6)


@pytest.mark.parametrize("wrong", [{"trials": 0}, {"first_seed": -1}, {"plan_delay_s": -0.002}, {"plan_delay_s": 0.2}])
def test_what_cannot_be_evaluated_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        Evaluation(course=FLAT, **wrong)


def test_a_search_starts_where_it_is_told_and_repeats_with_its_seed_in_any_number_of_processes() -> None:
    config = SearchConfig(courses=(FLAT,), generations=2, population=6, seed=3, time_limit_s=1.1)
    first, second = (list(search(config, ScriptedParameters(), processes)) for processes in (1, 2))
    assert [(g.mean, g.success) for g in first] == [(g.mean, g.success) for g in second]
    assert [g.index for g in first] == [0, 1]
    for generation in first:
        values = asdict(generation.mean)
        assert all(low <= values[name] <= high for name, (low, high) in BOUNDS.items())
        assert from_toml(ScriptedParameters, to_toml(generation.mean)) == generation.mean


def test_every_number_that_is_searched_exists_and_starts_within_its_bounds() -> None:
    values = asdict(ScriptedParameters())
    for name, (low, high) in BOUNDS.items():
        assert low <= values[name] <= high, name


def test_searches_and_evaluations_draw_different_trials() -> None:
    assert Trial.draw(FIRST_SEARCH_SEED) != Trial.draw(0)
    assert FIRST_SEARCH_SEED > 100_000


def test_drawn_courses_differ_from_trial_to_trial_and_repeat_with_the_seed() -> None:
    drawn = TerrainConfig(terrain="stepping_stones", gap_m=0.1, gap_max_m=0.5)
    first, second = courses_of(drawn, (7, 8)), courses_of(drawn, (7, 8))
    assert [terrain.edges_x.tolist() for terrain in first] == [terrain.edges_x.tolist() for terrain in second]
    assert first[0].finish_x != first[1].finish_x
    assert len(set(map(id, courses_of(FLAT, (7, 8))))) == 1
