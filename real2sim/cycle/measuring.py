"""How the hidden robot does on courses with the models before and after: trials as `saltus policy eval` runs them."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

from saltus.config import TerrainConfig, from_table
from saltus.heightmap.data.predicted import PredictedHeightsFactory
from saltus.models import model_id, model_path
from saltus.policy.evaluation.evaluate import Evaluation, TrialResult, evaluate
from saltus.policy.evaluation.trace import Failure
from saltus.policy.planner import make_planner
from saltus.real2sim.cycle.folder import MODELS, CycleFolder
from saltus.real2sim.cycle.settings import CycleSettings
from saltus.real2sim.progress import Progress
from saltus.workers import Listener

When = Literal["before", "after"]
MOMENTS: tuple[When, ...] = ("before", "after")
COURSES = {
    "stairs 0.20 m": TerrainConfig(terrain="stairs", rise_m=0.2),
    "stones": TerrainConfig(terrain="stepping_stones"),
    "step 0.50 m": TerrainConfig(terrain="step", height_m=0.5),
    "gap 0.80 m": TerrainConfig(terrain="gap", gap_m=0.8),
}

NOT_MEASURED = "before and after are not measured: no profile of the robot was given with --hidden"


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Trials of one course with two models, by their seeds."""

    models: dict[str, str]
    """Name of each network by its kind."""
    failures: dict[str, Failure]
    """Of each seed; empty for a success."""

    @property
    def successes(self) -> int:
        """Number of trials that succeeded."""
        return list(self.failures.values()).count("")


def measured(folder: CycleFolder, when: When, course: str) -> Measured | None:
    """What was measured so far; None where nothing was."""
    path = _file(folder, when, course)
    return from_table(Measured, json.loads(path.read_text())) if path.exists() else None


def measure(folder: CycleFolder, settings: CycleSettings, when: When, course: str, tell: Progress) -> Measured:
    """Runs the trials that are still missing of a course, and writes them down batch by batch."""
    models = {kind: model_path(kind, folder.model(kind) if when == "after" else None) for kind in MODELS}
    names = {str(kind): model_id(path.read_bytes()) for kind, path in models.items()}
    known = measured(folder, when, course)
    if known is None or known.models != names:  # of a training that was taken in another's place
        known = Measured(models=names, failures={})
    done = float(len(known.failures))

    def ran(trials: float) -> None:
        nonlocal done
        done += trials
        tell(f"{course} {when}", done / settings.trials)

    folder.measured.mkdir(exist_ok=True)
    missing = settings.trials - len(known.failures)
    if missing <= 0:
        return known
    for batch in run_trials(folder, settings, when, course, len(known.failures), missing, ran):
        known = replace(known, failures=known.failures | {str(seed): trial.failure for seed, trial in batch.items()})
        _file(folder, when, course).write_text(json.dumps(asdict(known)))
    return known


def run_trials(
    folder: CycleFolder,
    settings: CycleSettings,
    when: When,
    course: str,
    first: int,
    count: int,
    listener: Listener | None = None,
) -> Iterator[dict[int, TrialResult]]:
    """Runs `count` trials from the `first` on, counted from the cycle's seed; yields batches by seed."""
    models = {kind: folder.model(kind) if when == "after" else None for kind in MODELS}
    evaluation = Evaluation(
        course=COURSES[course], trials=count, seed=settings.seed + first, profile=str(folder.hidden)
    )
    heights = PredictedHeightsFactory(model=models["heightmap"], camera=settings.loop.camera)
    return evaluate(evaluation, heights, partial(make_planner, "learned", model=models["policy"]), listener=listener)


def _file(folder: CycleFolder, when: When, course: str) -> Path:
    return folder.measured / f"{when}-{course.partition(' ')[0]}.json"
