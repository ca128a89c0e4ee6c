"""Evaluations: what they report, with short trials."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from saltus.config import TerrainConfig
from saltus.depth_camera import SHIPPED
from saltus.errors import ConfigError
from saltus.loop.heights import exact_heights
from saltus.policy.evaluation.evaluate import (
    EvaluationSettings,
    courses_of,
    evaluate_policy,
    merge_batches,
)

FLAT = TerrainConfig(terrain="flat")


def test_outcomes_come_back_by_seed_and_do_not_depend_on_the_batch() -> None:
    evaluation = EvaluationSettings(
        robot="go1", grid="line", course=FLAT, trials=3, seed=7, time_limit_s=1.2
    )
    heard: list[float] = []
    (part,) = evaluate_policy(evaluation, exact_heights, processes=1, listener=heard.append)
    together = merge_batches([part])
    assert together.seeds == (7, 8, 9)
    assert together.successes == 0
    assert together.failures == {"timeout": 3}
    assert np.isnan(together.mean_speed_mps)
    assert len(heard) > 3
    assert all(share >= 0.0 for share in heard)
    assert sum(heard) == pytest.approx(3.0)
    alone = merge_batches(
        evaluate_policy(
            EvaluationSettings(
                robot="go1", grid="line", course=FLAT, trials=1, seed=8, time_limit_s=1.2
            ),
            exact_heights,
        )
    )
    for name, value in asdict(alone.outcomes[0]).items():
        assert asdict(together.outcomes[1])[name] == pytest.approx(value, abs=1e-6)


@pytest.mark.parametrize(
    "wrong", [{"trials": 0}, {"seed": -1}, {"plan_delay_s": -0.002}, {"plan_delay_s": 0.2}]
)
def test_what_cannot_be_evaluated_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        EvaluationSettings(robot="go1", grid="line", course=FLAT, **wrong)


def test_images_travel_as_long_as_their_camera_says(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(replace(SHIPPED["ideal"], latency_s=0.083).to_toml(), encoding="utf-8")
    setups = EvaluationSettings(robot="go1", grid="line", camera=str(path), course=FLAT).setups(
        (3, 4)
    )
    assert [setup.profile.camera_chain.latency.latency for setup in setups] == [0.083, 0.083]


def test_drawn_courses_differ_from_trial_to_trial_and_repeat_with_the_seed() -> None:
    drawn = TerrainConfig(terrain="stepping_stones", gap_m=0.1, gap_max_m=0.5)
    first, second = courses_of(drawn, (7, 8)), courses_of(drawn, (7, 8))
    assert [terrain.edges_x.tolist() for terrain in first] == [
        terrain.edges_x.tolist() for terrain in second
    ]
    assert first[0].finish_x != first[1].finish_x
    assert len(set(map(id, courses_of(FLAT, (7, 8))))) == 1
