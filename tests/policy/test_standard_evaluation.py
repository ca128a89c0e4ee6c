"""Evaluations with the deployed stack beside a training."""

import csv
import math
from pathlib import Path

import pytest
import torch
from samples import ROBOT
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from saltus.grid import LINE
from saltus.policy.env.curriculum import CurriculumSettings
from saltus.policy.env.jump_env import JumpEnv
from saltus.policy.env.settings import JumpEnvSettings, JumpTrainSettings, LearningSettings
from saltus.policy.training.background_evaluation import (
    BackgroundEvaluation,
    EvaluationRow,
    append_rows,
    evaluation_line,
    read_rows,
)
from saltus.policy.training.learner import JumpLearner
from saltus.policy.training.progress import JumpTally
from saltus.policy.training.standard_evaluation import COURSES, main
from saltus.policy.training.train import make_engine
from saltus.policy.training.training_record import TrainingRecord
from saltus.terrain.curriculum import FAMILIES

FLAT = CurriculumSettings(flat=1.0, stairs=0.0, stepping_stones=0.0, step=0.0, gap=0.0)
CONFIG = JumpTrainSettings(
    robot="go1",
    grid="line",
    robots=4,
    env=JumpEnvSettings(curriculum=FLAT),
    learning=LearningSettings(hidden=(8,), horizon=2, epochs=1, minibatches=1),
)
ROW = EvaluationRow(
    iteration=7, steps=9, course="gap_0.40", trials=2, success_rate=0.5, way_share=0.75,
    mean_speed_mps=1.5,
    time_p50_s=math.inf, failures="edge_hit 1",
)  # fmt: skip


def make_record(
    folder: Path, said: list[str], evaluate_s: float
) -> tuple[JumpLearner, TrainingRecord]:
    env = JumpEnv(
        make_engine(ROBOT, CONFIG.robots, CONFIG.env, "cpu", threads=1), CONFIG.env, LINE, seed=0
    )
    learner = JumpLearner(env, CONFIG.learning)
    record = TrainingRecord(
        folder,
        CONFIG,
        learner,
        lambda: JumpTally(folder, env, learner),
        commit="abc",
        start_s=0.0,
        evaluate_s=evaluate_s,
        kinds=[kind for kind, share in CONFIG.env.curriculum.shares.items() if share > 0.0],
        say=said.append,
    )
    return learner, record


def test_every_kind_of_terrain_that_saltus_brings_has_a_course() -> None:
    assert {course.terrain for course in COURSES.values()} == set(FAMILIES)


def test_rows_survive_their_table(tmp_path: Path) -> None:
    table = tmp_path / "evaluation.csv"
    assert read_rows(table) == []
    for _ in range(2):
        append_rows(table, [ROW])
    assert read_rows(table) == [ROW, ROW]
    assert "gap_0.40 50% (way 75%" in evaluation_line([ROW])


@pytest.mark.slow
def test_a_checkpoint_is_evaluated_beside_its_training(tmp_path: Path) -> None:
    said: list[str] = []
    learner, record = make_record(tmp_path, said, evaluate_s=1e-6)
    learner.collect()
    losses = learner.learn()
    record.step(losses)  # the clock of evaluations starts
    record.step(losses)  # one is due
    evaluation = record.evaluation
    assert evaluation is not None
    evaluation.wait(60.0)
    evaluation.every_s = math.inf  # no second one
    record.step(losses)
    record.close()
    (row,) = read_rows(tmp_path / "evaluation.csv")
    assert (row.iteration, row.steps, row.course, row.trials) == (1, 8, "flat", 8)
    assert 0.0 <= row.way_share <= 1.0
    assert any("deployed stack at iteration 1: flat" in line for line in said)
    curves = EventAccumulator(str(tmp_path)).Reload()
    (point,) = curves.Scalars("deployed/flat/way_share")
    assert (point.step, point.value) == (1, pytest.approx(row.way_share, abs=1e-4))
    assert torch.load(tmp_path / "checkpoint.pt", weights_only=True)["commit"] == "abc"


def test_one_that_still_runs_ends_with_the_training(tmp_path: Path) -> None:
    evaluation = BackgroundEvaluation(tmp_path / "t.csv", ["flat"], every_s=1.0, trials=1)
    assert not evaluation.due(10.0)
    assert not evaluation.due(10.5)
    assert evaluation.due(11.0)
    evaluation.start(tmp_path / "missing.pt", 11.0)
    assert not evaluation.due(100.0)
    evaluation.close()
    assert evaluation.finished() == []
    assert evaluation.due(12.0)


def test_a_machine_that_cannot_deploy_trains_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "saltus.policy.training.background_evaluation.NEEDED", ("onnx", "no_such_solver")
    )
    said: list[str] = []
    _, record = make_record(tmp_path, said, evaluate_s=1.0)
    record.close()
    assert said == ["no evaluation with the deployed stack: not installed here: no_such_solver"]
    assert record.evaluation is None


def test_the_command_writes_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    learner, record = make_record(tmp_path, [], evaluate_s=0.0)
    record.save()
    record.close()
    table = tmp_path / "table.csv"
    main([str(tmp_path / "checkpoint.pt"), str(table), "--kinds", "gap", "--trials", "1"])
    with table.open(newline="") as file:
        assert [line["course"] for line in csv.DictReader(file)] == ["gap_0.40", "gap_0.80"]
    assert "gap_0.80" in capsys.readouterr().out
    assert learner.iteration == 0
