"""Finding what the simulator lacks, from the first log to the profile with the patch."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from saltus.config import from_table
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.profile import Profile
from saltus.errors import ConfigError, RecordingError
from saltus.files import whole_folder
from saltus.real2sim.cycle.folder import CycleFolder
from saltus.real2sim.cycle.settings import CycleSettings
from saltus.real2sim.experiments.footage import FootageCamera
from saltus.real2sim.experiments.menu import experiment_named
from saltus.real2sim.experiments.run import run_experiment
from saltus.real2sim.patch import ProfilePatch, load_patch
from saltus.real2sim.pipeline import find_in_logs
from saltus.real2sim.progress import ProgressListener
from saltus.real2sim.reporting.verdict_text import verdict_sentence
from saltus.real2sim.results import Judgement
from saltus.real2sim.search.findings import SignalGap
from saltus.recordings.run_log import read_claims, write_run_log
from saltus.recordings.run_log_export import as_run_log
from saltus.robots.robot import Robot

ROUNDS = 2
"""Most searches: the first, and one with the experiment that separates the effects of a set."""
_GAPS = "gaps.json"


def search_until_told(
    logs: Sequence[Path],
    look: Callable[[Sequence[Path]], Judgement],
    record: Callable[[str], Path] | None,
) -> tuple[Judgement, tuple[Path, ...]]:
    """Looks at logs.

    Where effects stay a set, adds the log of the experiment that separates them and looks again.

    `record` runs an experiment by its name and returns its log; None where no experiment can be
    run. Returns the last judgement, and its logs.
    """
    for _ in range(1, ROUNDS):
        found = look(logs)
        proposed = found.verdict.next_experiment
        known = [log.name for log in logs]
        if (
            record is None
            or found.verdict.verdict != "set"
            or proposed is None
            or proposed.name in known
        ):
            return found, tuple(logs)
        logs = [*logs, record(proposed.name)]
    return look(logs), tuple(logs)


def record_logs(folder: CycleFolder, settings: CycleSettings, tell: ProgressListener) -> list[Path]:
    """The logs to look at: one's own, or of experiments on the hidden robot; those there are stay.

    Raises:
        RecordingError: a log cannot be read.
        ConfigError: a log is of another robot than the models.
    """
    if settings.logs:
        logs = [as_run_log(log, folder.logs / log.name) for log in settings.logs]
        for log in logs:
            if (robot := read_claims(log)["robot"]) != settings.loop.robot:
                raise ConfigError(
                    f"{log}: of the robot {robot}; the models that a cycle trains are of "
                    f"{settings.loop.robot}"
                )
        return logs
    return [record(folder, settings, tell, name) for name in settings.experiments]


def record(folder: CycleFolder, settings: CycleSettings, tell: ProgressListener, name: str) -> Path:
    """Runs an experiment on the hidden robot, which claims the camera's latency that is known."""
    log = folder.logs / name
    if log.exists():
        return log
    robot, known = folder.robot, folder.read(folder.known)
    latency = next((float(e.latency) for e in known.camera if isinstance(e, CameraLatency)), 0.0)
    made = run_experiment(
        experiment_named(name), robot, folder.read(folder.hidden), seed=settings.seed,
        camera=FootageCamera.on(robot, latency), progress=partial(tell, f"log {name}"),
    )  # fmt: skip
    with whole_folder(log) as partial_folder:
        write_run_log(made, partial_folder, robot)
    return log


def find_effects(
    folder: CycleFolder, settings: CycleSettings, logs: Sequence[Path], tell: ProgressListener
) -> tuple[Judgement, Judgement | None]:
    """Searches the logs, adds what is found to what is known, and searches them again with it.

    Returns both judgements, without the second where nothing was found that could be added.

    Raises:
        RecordingError: a log contradicts itself.
    """
    known = folder.read(folder.known)
    recorded = None if settings.logs else partial(record, folder, settings, tell)
    found, logs = search_until_told(
        logs, partial(_look, folder.found, known, settings.seed, tell, "find"), recorded
    )
    if found.verdict.verdict == "bad_log":
        raise RecordingError(
            f"{verdict_sentence(found.verdict)}: see {folder.found / 'report.html'}"
        )
    patched, _ = apply_what_can_be(found.patch, known, folder.robot)
    again = (
        _look(folder.again, patched, settings.seed, tell, "again", logs)
        if patched != known
        else None
    )
    folder.profile.write_text(patched.to_toml(), encoding="utf-8")
    return found, again


def apply_what_can_be(
    patch: ProfilePatch, known: Profile, robot: Robot
) -> tuple[Profile, tuple[str, ...]]:
    """The profile with the effects of the patch that it can have,
    and a line for each that it cannot.
    """
    refused = []
    for effect in patch.effects:
        try:
            known = replace(patch, effects=(effect,)).applied_to(known, robot)
        except ConfigError as error:
            refused.append(f"not applied: {effect.name}: {error}")
    return known, tuple(refused)


def not_applied(folder: CycleFolder) -> tuple[str, ...]:
    """A line for each effect that was found and that the profile cannot have."""
    return apply_what_can_be(
        load_patch(folder.found / "patch.toml"), folder.read(folder.known), folder.robot
    )[1]


def _look(
    out: Path, profile: Profile, seed: int, tell: ProgressListener, name: str, logs: Sequence[Path]
) -> Judgement:
    judged = find_in_logs(
        logs,
        out,
        profile=profile,
        seed=seed,
        progress=lambda stage, share: tell(f"{name}: {stage}", share),
    )
    gaps = [
        asdict(gap) | {"signal": f"{compared.problem.name}: {gap.signal}"}
        for each in judged.examinations
        for compared in each.comparisons
        for gap in compared.findings.gaps
    ]
    (out / _GAPS).write_text(json.dumps(gaps), encoding="utf-8")
    return judged


def gaps_of(found: Path) -> dict[str, SignalGap]:
    """The gap of each sensor's signals by their names, as the search in this folder began.

    None where there is none.
    """
    path = found / _GAPS
    gaps = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    return {gap["signal"]: from_table(SignalGap, gap) for gap in gaps}
