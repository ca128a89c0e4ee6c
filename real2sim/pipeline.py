"""From run logs to a verdict: screen, replay for each kind of sensor, search, merge, and what to add to a profile.

Problems of different sensors know nothing of each other: one that fails does not lose the verdicts of the others.
"""

import json
import logging
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path

from saltus.effects.profile import IDEAL, Profile
from saltus.errors import RecordingError
from saltus.real2sim.experiments.next_experiment import next_experiment
from saltus.real2sim.patch import Applicability, Evidence, Patch, applicability, evidence_of, supported
from saltus.real2sim.problem.camera.image_pixels import to_images
from saltus.real2sim.problem.joints.problem import JointProblem
from saltus.real2sim.problem.log import SHARED_CLAIMS, in_sequence, load, shifts_s
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.rebased import Rebased
from saltus.real2sim.resolve import resolved
from saltus.real2sim.results import Compared, Examined, Judgement, Progress
from saltus.real2sim.screening.align import align
from saltus.real2sim.screening.screen import screen
from saltus.real2sim.search.findings import FoundEffect
from saltus.real2sim.search.narrowed import Narrowed
from saltus.real2sim.search.saturation_curve import with_curves
from saltus.real2sim.search.search import search
from saltus.real2sim.sensors import SENSORS, Sensor
from saltus.real2sim.stacked import Stacked, stackable
from saltus.real2sim.verdict import merge
from saltus.recordings.run_log import RunLog

SIMULATIONS = 250
"""Sets of unknowns that a search of an ordinary log tries, for the progress bar."""


def find(
    runs: Sequence[Path],
    out: Path,
    *,
    profile: Profile = IDEAL,
    seed: int = 0,
    report: bool = True,
    progress: Progress | None = None,
) -> Judgement:
    """Finds what the simulator lacks and writes verdict.json, patch.toml and report.html.

    Args:
        runs: Directories of run logs of one robot. Those that claim the same rig are read as one log; what several
            rigs show of one kind of sensor is one problem where its unknowns mean the same.
        out: Folder for the results; it exists.
        profile: Effects that the simulator has already, on top of what the logs claim.
        seed: Of bootstraps.
        report: Whether to write report.html, which takes a second.
        progress: Told what is being done.

    Raises:
        RecordingError: a log that cannot be read or compared with anything.
    """
    logs = [load(group) for group in _groups(runs)]
    examined = examine_together(logs, profile=profile, seed=seed, progress=progress)
    judgement = judge(examined, tuple(evidence_of(run) for run in runs))
    _write(judgement, out)
    if report:
        from saltus.real2sim.reporting.report import write_report

        write_report(judgement, out / "report.html", profile=profile, seed=seed)
    return judgement


def examine(
    log: RunLog,
    *,
    profile: Profile = IDEAL,
    without: Collection[str] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> Examined:
    """Compares one log with the simulator, sensor by sensor.

    Args:
        log: Of one rig.
        profile: As in `find`.
        without: Effects that the library is to lack.
        seed: As in `find`.
        progress: As in `find`.
    """
    (examined,) = examine_together([log], profile=profile, without=without, seed=seed, progress=progress)
    return examined


def examine_together(
    logs: Sequence[RunLog],
    *,
    profile: Profile = IDEAL,
    without: Collection[str] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[Examined, ...]:
    """Compares logs of one robot on several rigs with the simulator, sensor by sensor; arguments as `examine`.

    Nothing is compared where a log is damaged.
    """
    tell = progress or (lambda _stage, _share: None)
    tell("screen", 0.0)
    found = [_screened(log) for log in logs]
    if any(each.is_bad for each in found):
        return tuple(found)
    found = [replace(each, offsets=align(each.log)) for each in found]
    posed = [sensor for sensor in SENSORS if not all(sensor.lacks(log) for log in logs)]
    for index, sensor in enumerate(posed):
        tell(sensor.name, index / len(posed))
        simulating = _counted(tell, sensor.name, index, len(posed))
        for own, problem in _problems(sensor, found, profile, without):
            found[own[0]] = _added(found[own[0]], sensor, problem, [logs[i] for i in own], seed, simulating)
        tell(sensor.name, (index + 1.0) / len(posed))
    return tuple(found)


def _screened(log: RunLog) -> Examined:
    untestable = {name: why for sensor in SENSORS if (why := sensor.lacks(log)) for name in sensor.effects}
    return Examined(log=log, faults=tuple(screen(log)), untestable=untestable)


def _problems(
    sensor: Sensor, found: list[Examined], profile: Profile, without: Collection[str]
) -> list[tuple[list[int], Problem]]:
    """The problems of one kind of sensor and which logs pose each; those that cannot be posed are told in `found`."""
    own: list[int] = []
    problems: list[Problem] = []
    for i, each in enumerate(found):
        if sensor.lacks(each.log):
            continue
        try:
            problems.append(_posed(sensor, each.log, profile, without))
            own.append(i)
        except Exception as error:  # whatever one sensor's data do to its problem, the others' verdicts stand
            found[i] = _failed(each, sensor, error)
    if len(problems) > 1 and stackable(problems):
        return [(own, Stacked(problems, shifts_s([found[i].log for i in own])))]
    return [([i], problem) for i, problem in zip(own, problems, strict=True)]


def _added(
    examined: Examined,
    sensor: Sensor,
    problem: Problem,
    logs: Sequence[RunLog],
    seed: int,
    progress: Callable[[str, int], None],
) -> Examined:
    """With what the search makes of one more problem."""
    try:
        findings = search(problem, progress=progress, seed=seed)
        if isinstance(problem, JointProblem):
            findings = with_curves(problem, findings)
    except Exception as error:  # as above
        return _failed(examined, sensor, error)
    log = logs[0] if len(logs) == 1 else in_sequence(logs, [str(number + 1) for number in range(len(logs))])
    return replace(examined, compared=(*examined.compared, Compared(problem=problem, findings=findings, log=log)))


def _failed(examined: Examined, sensor: Sensor, error: Exception) -> Examined:
    logging.getLogger(__name__).error("the %s could not be compared", sensor.name, exc_info=error)
    text = f"the {sensor.name} could not be compared: {type(error).__name__}: {error}"
    untestable = examined.untestable | dict.fromkeys(sensor.effects, text)
    return replace(examined, failures=(*examined.failures, text), untestable=untestable)


def _counted(tell: Progress, name: str, index: int, count: int) -> Callable[[str, int], None]:
    """Turns the search's count of simulations into a share of all problems."""
    done = 0

    def simulating(_stage: str, simulations: int) -> None:
        nonlocal done
        done += simulations
        tell(name, (index + min(0.95, done / SIMULATIONS)) / count)

    return simulating


def _posed(sensor: Sensor, log: RunLog, profile: Profile, without: Collection[str]) -> Problem:
    problem = sensor.problem(log)
    if profile != IDEAL:
        if "camera" in log.meta:
            profile = to_images(profile, float(log.meta["camera"]["fx"]))
        problem = Rebased(problem, profile)
    return Narrowed(problem, without) if without else problem


def judge(examined: tuple[Examined, ...], evidence: tuple[Evidence, ...]) -> Judgement:
    """One verdict for all logs, and the patch that follows from it.

    Raises:
        RecordingError: no sensor of any log could be compared.
    """
    bad = [fault.text for each in examined for fault in each.faults if fault.is_fatal]
    remarks = [text for each in examined for text in (*(f.text for f in each.faults), *each.failures)]
    if bad:
        verdict = merge((), log_faults=remarks)
    else:
        findings = resolved([compared.findings for each in examined for compared in each.compared])
        if not findings:
            raise RecordingError("nothing in these logs can be compared: " + "; ".join(remarks or ["no sensor data"]))
        verdict = replace(merge(findings), log_faults=tuple(remarks))
        testable = {name for f in findings for name in (*f.minimum_detectable, *_names(f.effects), *_names(f.rivals))}
        lacking = {name: why for each in examined for name, why in each.untestable.items()}
        untestable = {name: why for name, why in (lacking | verdict.untestable).items() if name not in testable}
        rivals = [rival for f in findings for rival in (*f.rivals, *f.effects)]
        verdict = replace(
            verdict,
            untestable=untestable,
            next_experiment=next_experiment(verdict.sets, rivals, [each.log.meta for each in examined]),
            minimum_detectable={n: e for n, e in verdict.minimum_detectable.items() if math.isfinite(e.value)},
        )
    patch = Patch(effects=supported(verdict.effects), evidence=evidence, range=_range(examined))
    return Judgement(verdict=verdict, patch=patch, examined=examined, evidence=evidence)


def _names(effects: Sequence[FoundEffect]) -> list[str]:
    return [effect.name for effect in effects]


def _range(examined: tuple[Examined, ...]) -> Applicability:
    """What all logs together reach to."""
    reaches = [vars(applicability(each.log)) for each in examined if not each.is_bad]
    names = {name for reach in reaches for name in reach}
    farthest = {name: [reach[name] for reach in reaches if reach[name] is not None] for name in names}
    return Applicability(**{name: max(values) for name, values in farthest.items() if values})


def _groups(runs: Sequence[Path]) -> list[list[Path]]:
    """Runs that claim the same rig, together."""
    if not runs:
        raise RecordingError("name at least one run log")
    groups: dict[str, list[Path]] = {}
    for run in runs:
        try:
            meta = json.loads((run / "meta.json").read_text())
            claims = json.dumps([meta.get(key) for key in SHARED_CLAIMS], sort_keys=True)
        except (OSError, ValueError, AttributeError) as error:
            raise RecordingError(f"{run} is not a run log: meta.json: {error}") from error
        groups.setdefault(claims, []).append(run)
    return list(groups.values())


def _write(judgement: Judgement, out: Path) -> None:
    """Writes the results; baselines are what simpler ways would have said, for the benchmark."""
    findings = [compared.findings for each in judgement.examined for compared in each.compared]
    baselines = {
        way: sorted({name for each in findings for name in getattr(each.baselines, way)})
        for way in ("threshold", "lowest_training_error")
    }
    try:
        (out / "verdict.json").write_text(judgement.verdict.to_json())
        (out / "patch.toml").write_text(judgement.patch.to_toml())
        (out / "baselines.json").write_text(json.dumps(baselines))
    except OSError as error:
        raise RecordingError(f"cannot write {out}: {error.strerror}") from error
