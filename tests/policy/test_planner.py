"""Planners by name, and what the shipped policy promises."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from samples import ROBOT

from saltus.config import PlannerName
from saltus.errors import ConfigError, ModelError
from saltus.grid import LINE
from saltus.policy.actor import PolicyActor
from saltus.policy.bounds import ActionBounds
from saltus.policy.planner import make_planner, warm_up
from saltus.policy.policy_features import policy_features, read_features, size_with
from saltus.policy.scripted import ScriptedPlanner
from saltus.resources import shipped_file


@pytest.mark.parametrize(
    ("name", "kind"), [("scripted", ScriptedPlanner), ("learned", PolicyActor)]
)
def test_planners_come_by_name_and_plan_at_once(name: PlannerName, kind: type) -> None:
    planner = make_planner(name, ROBOT, LINE)
    assert isinstance(planner, kind)
    warm_up(planner, ROBOT, LINE)


def test_only_the_learned_planner_takes_a_model(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--planner learned"):
        make_planner("scripted", ROBOT, LINE, shipped_file("models/policy.onnx"))
    with pytest.raises(ModelError, match=r"missing\.onnx"):
        make_planner("learned", ROBOT, LINE, tmp_path / "missing.onnx")


def test_the_shipped_policy_repeats_and_stays_within_its_bounds_whatever_it_sees() -> None:
    actor, bounds = PolicyActor(ROBOT, LINE, shipped_file("models/policy.onnx")), ActionBounds()
    given = np.random.default_rng(0).normal(0.0, 3.0, (200, size_with(LINE, actor.past_steps)))
    plan = actor.values(given)
    assert np.array_equal(plan, actor.values(given))
    assert (plan >= np.array(bounds.low) - 1e-5).all()
    assert (plan <= np.array(bounds.high) + 1e-5).all()
    alone = np.array([actor.values(row) for row in given[:20]])
    np.testing.assert_allclose(alone, plan[:20], atol=1e-4)


def test_what_the_policy_is_shown_can_be_read_back() -> None:
    rng = np.random.default_rng(0)
    shown = rng.normal(size=(5, 4, size_with(LINE)))
    shown[..., :4] = rng.uniform(size=(5, 4, 4)) < 0.5  # contact
    np.testing.assert_array_equal(policy_features(*read_features(shown, LINE)), shown)


def test_a_policy_is_refused_for_a_robot_that_it_was_not_made_for():
    other = replace(ROBOT, name="longlegs")
    with pytest.raises(ModelError, match="plans for the robot 'go1', not for 'longlegs'"):
        PolicyActor(other, LINE, shipped_file("models/policy.onnx"))
    # The same robot, measured again
    PolicyActor(replace(ROBOT, foot_radius=0.021), LINE, shipped_file("models/policy.onnx"))
