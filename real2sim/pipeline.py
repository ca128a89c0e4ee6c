"""From run logs to a verdict: screen, replay for each kind of sensor, search, merge, patch.

Sensors are compared independently: if one of them fails, the verdicts of the others stand.
"""

import json
import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from saltus.effects.image_pixels import to_images
from saltus.effects.profile import IDEAL, Profile
from saltus.errors import RecordingError, SaltusError
from saltus.files import atomic_write
from saltus.folders import ask_for_room
from saltus.real2sim.experiments.next_experiment import next_experiment
from saltus.real2sim.patch import (
    PatchEvidence,
    PatchRange,
    ProfilePatch,
    evidence_of,
    patch_range,
    patchable_effects,
)
from saltus.real2sim.problem.log import (
    claimed_model,
    in_sequence,
    load_rigs,
    quadruped_of,
    shifts_s,
)
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.progress import ComparisonProgress, ProgressListener
from saltus.real2sim.results import Judgement, LogExamination, SensorResult
from saltus.real2sim.screening.align import clock_offsets
from saltus.real2sim.screening.screen import screen_log
from saltus.real2sim.search.search import search_effects
from saltus.real2sim.sensors import SENSORS, Sensor
from saltus.real2sim.stacked_problem import RebasedProblem, StackedProblem, can_stack
from saltus.real2sim.verdict import MissingData, Verdict, merge_findings, without_ruled_out
from saltus.recordings.run_log import RunLog


def find_in_logs(
    runs: Sequence[Path],
    out: Path,
    *,
    profile: Profile = IDEAL,
    seed: int = 0,
    report: bool = True,
    progress: ProgressListener | None = None,
) -> Judgement:
    """Finds what the simulator lacks and writes verdict.json, patch.toml and report.html.

    Args:
        runs: Folders of run logs of one robot. Logs that claim the same rig are read as one. Logs
            of several rigs make one problem for each kind of sensor, if their unknowns mean the
            same.
        out: Folder for the results; it is made if it does not exist.
        profile: Effects that the simulator has already, besides what the logs claim.
        seed: Seed of the bootstrap.
        report: Whether to write report.html, which takes two seconds; if not, an older one in `out`
            is removed.
        progress: Called with the stage and the share that is done.

    Raises:
        SaltusError: a log that cannot be read or compared with anything, or a folder that cannot be
            written.
    """
    logs = load_rigs(runs)
    with _results_folder(out):
        examinations = examine_logs(logs, profile=profile, seed=seed, progress=progress)
        judgement = judge_logs(examinations, tuple(evidence_of(run) for run in runs), profile)
        texts: dict[str, str | None] = dict(_texts(judgement))
        texts["report.html"] = None  # a report of an earlier call would not belong to this verdict
        if report:
            from saltus.real2sim.reporting.report import report_page

            texts["report.html"] = report_page(judgement, seed=seed)
        _write(texts, out)
    if progress is not None:
        progress("done", 1.0)
    return judgement


def examine_logs(
    logs: Sequence[RunLog],
    *,
    profile: Profile = IDEAL,
    sensors: Sequence[Sensor] = SENSORS,
    seed: int = 0,
    progress: ProgressListener | None = None,
) -> tuple[LogExamination, ...]:
    """Screens logs of one robot, and searches each of its sensors for effects; one result a rig.

    If any log is damaged all come back with their faults, and nothing is searched. Arguments are as
    in `find_in_logs`; nothing is written.
    """
    if progress is not None:
        progress("screen", 0.0)
    found = [_screened(log) for log in logs]
    if any(each.is_bad for each in found):
        return tuple(found)
    found = [replace(each, offsets=clock_offsets(each.log)) for each in found]
    posed = [sensor for sensor in sensors if not all(sensor.lacks(log) for log in logs)]
    shown = ComparisonProgress(progress, posed)
    for sensor in posed:
        shown.begin(f"{sensor.name}: prepare")
        problems = _problems(sensor, found, profile)
        shown.end(sensor.prepare_s)
        for own, problem in problems:
            seconds = sensor.search_s / len(problems)
            searched = shown.search(f"{sensor.name}: search", seconds)
            found[own[0]] = _added(
                found[own[0]], sensor, problem, [logs[i] for i in own], seed, searched
            )
            shown.end(seconds)
        if not problems:
            shown.end(sensor.search_s)
    shown.begin("conclude")
    return tuple(found)


def _screened(log: RunLog) -> LogExamination:
    examination = LogExamination(log=log, faults=tuple(screen_log(log)), untestable={})
    if examination.is_bad:  # a damaged log says nothing about its sensors
        return examination
    lacking = {sensor: why for sensor in SENSORS if (why := sensor.lacks(log))}
    untestable = {name: why for sensor, why in lacking.items() for name in sensor.effects}
    return replace(
        examination,
        untestable=untestable,
        lacking={sensor.name: why for sensor, why in lacking.items()},
    )


def _problems(
    sensor: Sensor, found: list[LogExamination], profile: Profile
) -> list[tuple[list[int], Problem]]:
    """Problems of one kind of sensor, each with the indices of its logs.

    What goes wrong, and what is too short to be tested, is noted in `found`.
    """
    posing = [i for i, each in enumerate(found) if not sensor.lacks(each.log)]
    if brief := sensor.too_short([found[i].log for i in posing]):
        for i in posing:
            found[i] = _without(found[i], sensor, brief)
        return []
    own: list[int] = []
    problems: list[Problem] = []
    for i in posing:
        try:
            problems.append(_posed(sensor, found[i].log, profile))
            own.append(i)
        except (
            Exception
        ) as error:  # whatever goes wrong with one sensor, the verdicts of the others stand
            found[i] = _failed(found[i], sensor, error)
    if len(problems) > 1 and can_stack(problems):
        return [(own, StackedProblem(problems, shifts_s([found[i].log for i in own])))]
    posed = []
    for i, problem in zip(own, problems, strict=True):
        if brief := sensor.too_short([found[i].log]):
            found[i] = _without(found[i], sensor, brief)
        else:
            posed.append(([i], problem))
    return posed


def _without(examination: LogExamination, sensor: Sensor, why: str) -> LogExamination:
    """The examination of a log that tells nothing of a sensor, and why."""
    return replace(
        examination,
        untestable=examination.untestable | dict.fromkeys(sensor.effects, why),
        lacking=examination.lacking | {sensor.name: why},
        brief=examination.brief | {sensor.name: why},
    )


def _added(
    examination: LogExamination,
    sensor: Sensor,
    problem: Problem,
    logs: Sequence[RunLog],
    seed: int,
    progress: Callable[[str, int], None],
) -> LogExamination:
    """The examination with the findings of one more problem.

    Without them where nothing was left to test them by.
    """
    try:
        findings = sensor.finished(problem, search_effects(problem, progress=progress, seed=seed))
    except Exception as error:  # as above
        return _failed(examination, sensor, error)
    if not findings.gaps:
        return _without(examination, sensor, f"no part of the {sensor.needs} is left to test by")
    log = (
        logs[0]
        if len(logs) == 1
        else in_sequence(logs, [str(number + 1) for number in range(len(logs))])
    )
    return replace(
        examination,
        comparisons=(
            *examination.comparisons,
            SensorResult(problem=problem, findings=findings, log=log),
        ),
    )


def _failed(examination: LogExamination, sensor: Sensor, error: Exception) -> LogExamination:
    logging.getLogger(__name__).info("the %s could not be compared", sensor.name, exc_info=error)
    said = str(error).partition("\n")[0] if isinstance(error, SaltusError) else repr(error)
    text = f"the {sensor.name} could not be compared: {said}"
    untestable = examination.untestable | dict.fromkeys(sensor.effects, text)
    return replace(examination, failures=(*examination.failures, text), untestable=untestable)


def _posed(sensor: Sensor, log: RunLog, profile: Profile) -> Problem:
    problem = sensor.problem(log)
    if profile == IDEAL:
        return problem
    if log.meta.get("camera"):
        profile = to_images(profile, float(log.meta["camera"]["fx"]))
    return RebasedProblem(problem, profile)


def judge_logs(
    examinations: tuple[LogExamination, ...],
    evidence: tuple[PatchEvidence, ...],
    profile: Profile = IDEAL,
) -> Judgement:
    """One verdict for all logs, and the patch;
    `RecordingError` if no sensor of any log could be compared.
    """
    bad = [fault.text for each in examinations for fault in each.faults if fault.is_fatal]
    remarks = [
        text for each in examinations for text in (*(f.text for f in each.faults), *each.failures)
    ]
    if bad:
        verdict = merge_findings((), log_faults=remarks)
    else:
        findings = without_ruled_out(
            [comparison.findings for each in examinations for comparison in each.comparisons]
        )
        if not findings and not any(each.brief for each in examinations):
            lacks = sorted({why for each in examinations for why in each.untestable.values()})
            raise RecordingError(
                "nothing in these logs can be compared: " + "; ".join(remarks or lacks)
            )
        # without any test nothing is known: neither that the log agrees with the simulator, nor
        # what differs
        verdict = merge_findings(findings) if findings else Verdict(verdict="unexplained")
        brief = {sensor: why for each in examinations for sensor, why in each.brief.items()}
        missing = tuple(
            MissingData(sensor=s.name, why=brief[s.name], experiment=s.experiment)
            for s in SENSORS
            if s.name in brief
        )
        verdict = replace(verdict, log_faults=tuple(remarks), missing=missing)
        rivals = [rival for f in findings for rival in (*f.rivals, *f.effects)]
        testable = {rival.name for rival in rivals}.union(*(f.minimum_detectable for f in findings))
        lacking = {name: why for each in examinations for name, why in each.untestable.items()}
        untestable = {
            name: why
            for name, why in (lacking | verdict.untestable).items()
            if name not in testable
        }
        rigs = [each.log.meta for each in examinations]
        verdict = replace(
            verdict,
            untestable=untestable,
            next_experiment=next_experiment(
                quadruped_of(claimed_model(examinations[0].log)), verdict.sets, rivals, rigs
            ),
            minimum_detectable={
                n: e for n, e in verdict.minimum_detectable.items() if math.isfinite(e.value)
            },
        )
    patch = ProfilePatch(
        effects=patchable_effects(verdict.effects, profile),
        evidence=evidence,
        range=_range(examinations),
    )
    return Judgement(
        verdict=verdict, patch=patch, examinations=examinations, evidence=evidence, profile=profile
    )


def _range(examinations: tuple[LogExamination, ...]) -> PatchRange:
    """The largest range that any of the logs covers."""
    reaches = [vars(patch_range(each.log)) for each in examinations if not each.is_bad]
    names = {name for reach in reaches for name in reach}
    farthest = {
        name: [reach[name] for reach in reaches if reach[name] is not None] for name in names
    }
    return PatchRange(**{name: max(values) for name, values in farthest.items() if values})


@contextmanager
def _results_folder(out: Path) -> Iterator[None]:
    """Makes the folder for results before the long work,
    and removes it again if nothing is written.
    """
    is_new = not out.exists()
    ask_for_room(out)
    try:
        yield
    except BaseException:
        if is_new:
            with suppress(OSError):  # it holds something
                out.rmdir()
        raise


def _texts(judgement: Judgement) -> dict[str, str]:
    """Results by file name.

    The baselines, what simpler methods would have named, are for the benchmark.
    """
    findings = [
        comparison.findings for each in judgement.examinations for comparison in each.comparisons
    ]
    baselines = {
        way: sorted({name for each in findings for name in getattr(each.baselines, way)})
        for way in ("threshold", "lowest_training_error")
    }
    return {
        "verdict.json": judgement.verdict.to_json(),
        "patch.toml": judgement.patch.to_toml(),
        "baselines.json": json.dumps(baselines),
    }


def _write(texts: Mapping[str, str | None], out: Path) -> None:
    """Writes all files or none. A file without text is removed."""
    try:
        with ExitStack() as files:
            for name, text in texts.items():
                partial = files.enter_context(atomic_write(out / name))
                partial.write_text(text or "", encoding="utf-8")
            if texts.get("report.html"):
                from saltus.reports.page import bring_plotly

                bring_plotly(out, texts["report.html"] or "")
        for name in (name for name, text in texts.items() if text is None):
            (out / name).unlink()
    except OSError as error:
        raise RecordingError(f"cannot write {out}: {error.strerror}") from error
