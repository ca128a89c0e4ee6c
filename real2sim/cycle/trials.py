"""Trials of a cycle's robots on its courses, with the models of a cycle or the shipped ones."""

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

from saltus.config import TerrainConfig
from saltus.heightmap.data.predicted import PredictedHeightsFactory
from saltus.heightmap.settings import ClosedLoop
from saltus.policy.evaluation.evaluate import EvaluationSettings, TrialResult, evaluate_policy
from saltus.policy.planner import make_planner
from saltus.used_networks import ModelKind, model_id, model_path
from saltus.workers import WorkerListener

COURSES = {
    "stairs 0.20 m": TerrainConfig(terrain="stairs", rise_m=0.2),
    "stones": TerrainConfig(terrain="stepping_stones"),
    "step 0.50 m": TerrainConfig(terrain="step", height_m=0.5),
    "gap 0.80 m": TerrainConfig(terrain="gap", gap_m=0.8),
}


def names_of(models: Mapping[ModelKind, Path | None], robot: str) -> dict[str, str]:
    """Name of each network by its kind; the shipped one of the robot where no file is named."""
    return {
        str(kind): model_id(model_path(kind, model, robot).read_bytes())
        for kind, model in models.items()
    }


def trials_of(
    loop: ClosedLoop, profile: Path, known: str, course: str, seed: int, count: int
) -> EvaluationSettings:
    """`count` trials of robots of a profile, the first with the seed.

    The leg controller makes up for what the profile `known` says of the drives.
    """
    return EvaluationSettings(
        robot=loop.robot, grid=loop.grid, camera=loop.camera, course=COURSES[course], trials=count,
        seed=seed,
        profile=str(profile), known=known,
    )  # fmt: skip


def run_trials(
    models: Mapping[ModelKind, Path | None],
    evaluation: EvaluationSettings,
    listener: WorkerListener | None = None,
) -> Iterator[dict[int, TrialResult]]:
    """Runs trials with networks, the shipped ones where none is named; yields batches by seed."""
    heights = PredictedHeightsFactory(model=models["heightmap"])
    return evaluate_policy(
        evaluation,
        heights,
        partial(make_planner, "learned", model=models["policy"]),
        listener=listener,
    )
