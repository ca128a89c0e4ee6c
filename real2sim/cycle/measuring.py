"""How the hidden robot does on courses with the models before and after:
trials as `saltus policy eval` runs them.
"""

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from saltus.config import from_table
from saltus.files import write_whole
from saltus.policy.evaluation.trial_trace import FailureKind
from saltus.real2sim.cycle.choosing import known_after, taken_models
from saltus.real2sim.cycle.folder import MODELS, CycleFolder
from saltus.real2sim.cycle.settings import CycleSettings
from saltus.real2sim.cycle.trials import names_of, run_trials, trials_of
from saltus.real2sim.progress import ProgressListener
from saltus.used_networks import ModelKind

BeforeOrAfter = Literal["before", "after"]
MOMENTS: tuple[BeforeOrAfter, ...] = ("before", "after")
NOT_MEASURED = "before and after are not measured: no profile of the robot was given with --hidden"


@dataclass(frozen=True, kw_only=True)
class MeasuredCourse:
    """Trials of one course with two models, by their seeds."""

    models: dict[str, str]
    """Name of each network by its kind."""
    failures: dict[str, FailureKind]
    """Failures of each seed; empty for a success."""

    @property
    def successes(self) -> int:
        """Number of trials that succeeded."""
        return list(self.failures.values()).count("")


def read_measurement(
    folder: CycleFolder, when: BeforeOrAfter, course: str
) -> MeasuredCourse | None:
    """Reads what was measured so far; None where nothing was."""
    path = _file(folder, when, course)
    return (
        from_table(MeasuredCourse, json.loads(path.read_text(encoding="utf-8")))
        if path.exists()
        else None
    )


def measure(
    folder: CycleFolder,
    settings: CycleSettings,
    when: BeforeOrAfter,
    course: str,
    tell: ProgressListener,
) -> MeasuredCourse:
    """Runs the trials that are still missing of a course, and writes them down batch by batch."""
    models = models_of(folder, when)
    names = names_of(models, settings.loop.robot)
    known = read_measurement(folder, when, course)
    if known is None or known.models != names:  # of a training that was taken in another's place
        known = MeasuredCourse(models=names, failures={})
    done = float(len(known.failures))

    def ran(trials: float) -> None:
        nonlocal done
        done += trials
        tell(f"{course} {when}", done / settings.trials)

    folder.measured.mkdir(exist_ok=True)
    missing = settings.trials - len(known.failures)
    if missing <= 0:
        return known
    seed = settings.seed + len(known.failures)
    robot = (settings.loop, folder.hidden, known_of(folder, when))
    for batch in run_trials(models, trials_of(*robot, course, seed, missing), ran):
        known = replace(
            known,
            failures=known.failures | {str(seed): trial.failure for seed, trial in batch.items()},
        )
        write_whole(_file(folder, when, course), json.dumps(asdict(known)), synced=True)
    return known


def models_of(folder: CycleFolder, when: BeforeOrAfter) -> dict[ModelKind, Path | None]:
    """The ONNX file of each kind; None for the shipped one."""
    taken = taken_models(folder) if when == "after" else ()
    return {kind: folder.model(kind) if kind in taken else None for kind in MODELS}


def known_of(folder: CycleFolder, when: BeforeOrAfter) -> str:
    """Path of the profile of what is known of the robot: before the search, and after it."""
    return str(known_after(folder) if when == "after" else folder.known)


def _file(folder: CycleFolder, when: BeforeOrAfter, course: str) -> Path:
    return folder.measured / f"{when}-{course.partition(' ')[0]}.json"
