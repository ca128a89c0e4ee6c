"""The deployed stack on the courses that the policy is meant for, while it is still being trained.

    python -m saltus.policy.training.standard_evaluation CHECKPOINT TABLE [--kinds stairs gap] [--trials 8]
        [--processes 4]

Exports the checkpoint and runs it as deployed: the law in numpy, exact stance forces, ONNX Runtime,
MuJoCo, all effects of the drives, what a trial draws. One row a course is added to TABLE.
`saltus.policy.training.background_evaluation` runs this beside a training.
"""

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from saltus.config import TerrainConfig
from saltus.loop.heights import shifted_heights
from saltus.model_file import ModelFile
from saltus.policy.evaluation.evaluate import (
    EvaluationResult,
    EvaluationSettings,
    merge_batches,
    run_batch,
)
from saltus.policy.planner import make_planner
from saltus.policy.training.background_evaluation import EvaluationRow, append_rows, evaluation_line
from saltus.terrain.course_law import PAPER
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.own_families import own_families
from saltus.tuning import stand_back
from saltus.workers import in_order

FIRST_SEED = 20_000
"""Trials of none of the published figures."""
TRIALS = 8
"""Trials of each course: a share is then known to within 0.18 (one sigma); curves show what single
points do not."""

COURSES: dict[str, TerrainConfig] = {
    "flat": TerrainConfig(terrain="flat"),
    "stairs_0.10": TerrainConfig(terrain="stairs", rise_m=0.10, run_m=0.25),
    "stairs_0.15": TerrainConfig(terrain="stairs", rise_m=0.15, run_m=0.25),
    "stairs_0.20": TerrainConfig(terrain="stairs", rise_m=0.20, run_m=0.25),
    "stones_0.20": TerrainConfig(terrain="stepping_stones", stone_m=0.5, gap_m=0.20),
    "stones_0.1_to_0.5": TerrainConfig(
        terrain="stepping_stones", stone_m=0.5, gap_m=0.1, gap_max_m=0.5
    ),
    "step_0.30": TerrainConfig(terrain="step", height_m=0.30),
    "step_0.60": TerrainConfig(terrain="step", height_m=0.60),
    "gap_0.40": TerrainConfig(terrain="gap", gap_m=0.40),
    "gap_0.80": TerrainConfig(terrain="gap", gap_m=0.80),
    "stairs_down_0.15": TerrainConfig(terrain="stairs_down", rise_m=0.15),
    "step_down_0.60": TerrainConfig(terrain="step_down", height_m=0.60),
    "pyramid_0.15": TerrainConfig(terrain="pyramid", rise_m=0.15),
    "irregular_0.22": TerrainConfig(terrain="irregular", rise_m=0.22),
    "hurdles_0.20": TerrainConfig(terrain="hurdles", height_m=0.20),
    "ditch_0.50": TerrainConfig(terrain="ditch", gap_m=0.50, depth_m=1.0),
    "ramp_up_20": TerrainConfig(terrain="ramp_up", slope_deg=20.0),
    "ramp_down_20": TerrainConfig(terrain="ramp_down", slope_deg=20.0),
}
"""Courses of each kind of terrain that a policy is trained on: what the paper's robot did, and
something easier that shows progress before; of kinds that it did not meet, what Saltus aims at."""


def course_of(name: str) -> TerrainConfig:
    """One of `COURSES`; else that family of one's own, at medium difficulty."""
    return COURSES.get(name, TerrainConfig(terrain=name))


def evaluate_checkpoint(
    checkpoint: Path, courses: Sequence[str], trials: int, processes: int
) -> Iterator[EvaluationRow]:
    """Exports a checkpoint and runs it on courses, one batch of robots each.

    Rows come in the order of the courses.

    Raises:
        SaltusError: the checkpoint cannot be read or does not fit.
    """
    from saltus.policy.training.checkpoint import read_policy_checkpoint, training_config

    # here: the processes that run trials need no torch
    from saltus.policy.training.export import (
        export_policy,
    )

    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder) / "policy.onnx"
        export_policy(checkpoint, model)
        # Knows what was exported: a training may have replaced the checkpoint since
        file = ModelFile(model)
        iteration, steps = int(file.field("iteration")), int(file.field("steps"))
        trained = training_config(read_policy_checkpoint(checkpoint))
        run = partial(_results, trained.robot, trained.grid, model, trials)
        results = list(in_order(run, courses, processes))
    for course, result in zip(courses, results, strict=True):
        yield _row(course, result, iteration, steps)


def _results(robot: str, grid: str, model: Path, trials: int, course: str) -> EvaluationResult:
    evaluation = EvaluationSettings(
        robot=robot, grid=grid, course=course_of(course), trials=trials, seed=FIRST_SEED
    )
    seeds = range(FIRST_SEED, FIRST_SEED + trials)
    return merge_batches(
        [
            run_batch(
                evaluation, shifted_heights, partial(make_planner, "learned", model=model), seeds
            )
        ]
    )


def _row(course: str, result: EvaluationResult, iteration: int, steps: int) -> EvaluationRow:
    finish = make_terrain(course_of(course)).finish_x
    way = [outcome.distance_m / finish for outcome in result.outcomes]
    return EvaluationRow(
        iteration=iteration,
        steps=steps,
        course=course,
        trials=len(result.trials),
        success_rate=result.successes / len(result.trials),
        way_share=float(np.mean(np.clip(way, 0.0, 1.0))),
        mean_speed_mps=round(result.mean_speed_mps, 3),
        time_p50_s=round(result.median_time_s, 3),
        failures=", ".join(f"{cause} {count}" for cause, count in sorted(result.failures.items())),
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Parses the command line, evaluates, and adds the rows."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("table", type=Path)
    parser.add_argument("--kinds", nargs="+", default=list(PAPER), help="of terrain")
    parser.add_argument("--trials", type=int, default=TRIALS, help="of each course")
    parser.add_argument("--processes", type=int, default=1)
    given = parser.parse_args(arguments)
    courses = [name for name, course in COURSES.items() if course.terrain in given.kinds]
    courses += sorted(own_families().keys() & given.kinds)
    rows = list(evaluate_checkpoint(given.checkpoint, courses, given.trials, given.processes))
    append_rows(given.table, rows)
    print(evaluation_line(rows))  # noqa: T201


if __name__ == "__main__":
    stand_back()
    main()
