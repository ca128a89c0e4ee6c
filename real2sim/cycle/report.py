"""One HTML file that tells a cycle: what was hidden, what was found, what training with it is worth."""

import html
import json
import math
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from saltus.heightmap.data.shards import read_records
from saltus.models import ModelKind
from saltus.policy.evaluation.evaluate import collect, courses_of
from saltus.policy.evaluation.pictures import picture_strip
from saltus.provenance import commit
from saltus.real2sim.cycle import figures
from saltus.real2sim.cycle.choosing import DRIVES, chosen, verdict
from saltus.real2sim.cycle.finding import gaps_of, not_applied
from saltus.real2sim.cycle.folder import MODELS, CycleFolder
from saltus.real2sim.cycle.measuring import MOMENTS, NOT_MEASURED, Measured, When, known_of, measured, models_of
from saltus.real2sim.cycle.settings import CycleSettings
from saltus.real2sim.cycle.trials import COURSES, run_trials
from saltus.real2sim.cycle.truth import Row, rows_of
from saltus.real2sim.reporting.figures import gap_figure
from saltus.real2sim.reporting.report import MORE_STYLE
from saltus.recordings.page import figure_html, page, table, write_page

Courses = dict[str, dict[When, Measured]]


def results(folder: CycleFolder) -> dict[str, Any]:
    """What a program would read of a cycle."""
    courses, choice = _courses(folder), chosen(folder)
    return {
        "report": str(folder.report),
        "profile": str(folder.profile),
        "found": _verdict(folder.found),
        "again": _verdict(folder.again),
        "effects": [asdict(row) for row in rows_of(folder)],
        "not_applied": not_applied(folder),
        "models": trained(folder),
        "choice": None if choice is None else asdict(choice) | {"taken": choice.taken, "drives": DRIVES in choice.best},
        "courses": {
            course: {
                when: {"successes": trials.successes, "trials": len(trials.failures), "models": trials.models}
                for when, trials in done.items()
            }
            for course, done in courses.items()
        },
    }


def trained(folder: CycleFolder) -> dict[ModelKind, str]:
    """What became of each model; nothing where training is not over."""
    became: dict[ModelKind, str] = (
        json.loads(folder.trained.read_text(encoding="utf-8")) if folder.trained.exists() else {}
    )
    return became


def write_cycle_report(folder: CycleFolder, settings: CycleSettings) -> None:
    """Writes the report of what is done so far; it opens without a network."""
    rows, courses = rows_of(folder), _courses(folder)
    parts = [
        f"<h1>{html.escape(_headline(rows, courses))}</h1>",
        "<h2>What was hidden, and what was found</h2>",
        *_found(folder, rows),
        "<h2>The gap between logs and simulation</h2>",
        *_gap(folder),
        "<h2>Training</h2>",
        *_training(folder, settings),
        "<h2>The hidden robot on courses, before and after</h2>",
        *_success(folder, settings, courses),
        "<h2>What these logs cannot show</h2>",
        _untestable(folder),
        "<h2>Provenance</h2>",
        f"<pre>commit = {commit()}\n\n{html.escape(folder.settings.read_text(encoding='utf-8'))}</pre>",
    ]
    write_page(folder.report, page("The cycle", "\n".join(parts), MORE_STYLE))


def _courses(folder: CycleFolder) -> Courses:
    """What was measured so far."""
    pairs = {course: {when: measured(folder, when, course) for when in MOMENTS} for course in COURSES}
    return {
        course: known
        for course, done in pairs.items()
        if (known := {when: trials for when, trials in done.items() if trials is not None and trials.failures})
    }


def _verdict(found: Path) -> dict[str, Any] | None:
    path = found / "verdict.json"
    verdict: dict[str, Any] | None = json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
    return verdict


def _headline(rows: list[Row], courses: Courses) -> str:
    hidden = [row for row in rows if row.true is not None and row.true != row.known]
    found = sum(row.found is not None for row in hidden)
    said = [f"{found} of {len(hidden)} hidden parameters found" if hidden else f"{len(rows)} parameters found"]
    whole = [done for done in courses.values() if len(done) == len(MOMENTS)]
    for when in MOMENTS:
        trials = [done[when] for done in whole]
        if trials:
            share = sum(each.successes for each in trials) / sum(len(each.failures) for each in trials)
            said.append(f"{share:.0%} of all trials succeed {when}")
    return f"The cycle: {'; '.join(said)}"


def _found(folder: CycleFolder, rows: list[Row]) -> list[str]:
    """A figure where the truth is known, and a table."""
    parts = [
        "" if folder.hidden.exists() else "<p>No profile of the robot is known: there is no truth to compare with.</p>"
    ]
    if not rows:
        return [*parts, f"<p>Nothing was found: {_words(_verdict(folder.found))}.</p>", _link(folder.found)]
    hidden = [row for row in rows if row.true is not None and row.true != row.known]
    if hidden:
        parts.append(figure_html(figures.truth_figure(hidden)))
    head = ("effect", "where", "parameter", "unit", "known before", "hidden", "found", "90 % interval", "remark")
    cells = [
        (row.effect, row.where, row.parameter, row.unit, _number(row.known), _number(row.true), _number(row.found),
         "-" if row.ci90 is None else f"{_number(row.ci90[0])} to {_number(row.ci90[1])}", row.remark)
        for row in rows
    ]  # fmt: skip
    refused = (f"<p>{html.escape(line)}</p>" for line in not_applied(folder))
    return [*parts, table(head, cells, "text"), *refused, _link(folder.found)]


def _gap(folder: CycleFolder) -> list[str]:
    """Figures of the gap before the patch and with it."""
    before, after = gaps_of(folder.found), gaps_of(folder.again)
    shown = [replace(gap, after=after[name].before if name in after else gap.before) for name, gap in before.items()]
    again = _verdict(folder.again)
    words = (
        f"With what was found in the simulator: {_words(again)}." if again else "Nothing was found that could be added."
    )
    parts = [
        '<p class="note">Root mean square of each signal on segments that no fit has seen, in units of noise, without '
        "and with the patch in the simulator.</p>",
        f"<p>Before: {_words(_verdict(folder.found))}. {words}</p>",
    ]
    if shown:
        parts.append(figure_html(gap_figure(shown)))
    return [*parts, _link(folder.again)] if again else parts


def _training(folder: CycleFolder, settings: CycleSettings) -> list[str]:
    became = trained(folder)
    if not became:
        return ["<p>Not done yet.</p>"]
    rows = [(f"{kind} model", what) for kind, what in became.items()]
    if folder.dataset.exists():
        records = read_records(folder.dataset)
        ticks = sum(record.ticks for record in records)
        rows.append(("predictor's data", f"{ticks} steps of 10 ms of robots with the profile that was found"))
        rows.append(("predictor's training", f"{settings.predictor.updates} updates from the shipped checkpoint"))
    return [table((), rows, "text"), *_choice(folder)]


def _choice(folder: CycleFolder) -> list[str]:
    """Which of the trained models were taken, and why."""
    choice = chosen(folder)
    if choice is None:
        return []
    head = ("models", *COURSES)
    rows = [
        (
            _named(pair),
            *(f"{tally.successes} of {tally.trials}" for tally in tallies.values()),
        )
        for pair, tallies in choice.tallies.items()
    ]
    note = (
        '<p class="note">Simulated robots with the found profile: the pair with the best worst course is taken. '
        "The robot itself was not asked.</p>"
    )
    said = [f"{kind} model {verdict(choice, kind)}" for kind in MODELS if str(kind) in choice.models]
    if any(DRIVES in pair for pair in choice.tallies):
        said.append("the leg controller " + ("makes up for the drives" if DRIVES in choice.best else "stays as it was"))
    return [note, table(head, rows, "text"), f"<p>{'; '.join(said)}.</p>"]


def _named(pair: str) -> str:
    """What is new in a pair, in words."""
    names = [name for name in pair.split("+") if name]
    models = " and ".join(name for name in names if name != DRIVES)
    words = [f"trained {models}" if models else "as shipped", *(["drives made up for"] if DRIVES in names else [])]
    return ", ".join(words)


def _success(folder: CycleFolder, settings: CycleSettings, courses: Courses) -> list[str]:
    if not courses:
        return [f"<p>{'Not measured yet.' if folder.hidden.exists() else NOT_MEASURED}</p>"]
    failures = [
        (course, when, f"{trials.successes} of {len(trials.failures)}", _causes(trials))
        for course, done in courses.items()
        for when, trials in done.items()
    ]
    note = '<p class="note">Predicted heights, trials of the same seeds; bars with 95 % intervals.</p>'
    parts = [note, figure_html(figures.success_figure(courses))]
    parts.append(table(("course", "models", "succeeded", "why the others failed"), failures, "text"))
    return [*parts, *_pictures(folder, settings, courses)]


def _causes(trials: Measured) -> str:
    causes = Counter(cause for cause in trials.failures.values() if cause)
    return ", ".join(f"{count} {cause.replace('_', ' ')}" for cause, count in causes.most_common()) or "-"


def _pictures(folder: CycleFolder, settings: CycleSettings, courses: Courses) -> list[str]:
    """One trial before and after, on the course where most changed; there the first that failed before."""
    gains = {c: done["after"].successes - done["before"].successes for c, done in courses.items() if len(done) == 2}
    if not gains:
        return []
    course = max(gains, key=lambda name: gains[name])
    before = courses[course]["before"].failures
    seed = next((seed for seed, cause in before.items() if cause), next(iter(before)))
    return [_strip(folder, settings, courses[course][when], when, course, int(seed)) for when in MOMENTS]


def _strip(folder: CycleFolder, settings: CycleSettings, trials: Measured, when: When, course: str, seed: int) -> str:
    """Pictures of a trial, which is run again for them once."""
    kept = folder.measured / f"{when}-{course.partition(' ')[0]}-{seed}-{'-'.join(trials.models.values())}.html"
    if not kept.exists():
        models = models_of(folder, when)
        robot = (settings.loop.robot, folder.hidden, known_of(folder, when), settings.loop.camera)
        trial = collect(run_trials(models, *robot, course, seed, 1)).trials[0]
        (terrain,) = courses_of(COURSES[course], [seed])
        ended = trial.failure.replace("_", " ") or "success"
        pictures = picture_strip(folder.robot, terrain, trial.trace)
        kept.write_text(f"<h3>{course}, seed {seed}, {when}: {ended}</h3>{pictures}", encoding="utf-8")
    return kept.read_text(encoding="utf-8")


def _untestable(folder: CycleFolder) -> str:
    reasons: dict[str, list[str]] = {}
    for each in (_verdict(folder.found) or {})["untestable"]:
        reasons.setdefault(each["why"], []).append(each["name"])
    return table(("effects", "why"), [(", ".join(names), why) for why, names in reasons.items()], "words")


def _words(verdict: dict[str, Any] | None) -> str:
    if verdict is None:
        return "not searched"
    gap = verdict["gap"]
    size = "" if gap is None else f", mean squared residual {gap['before']:.3g} where noise alone is {gap['floor']:.3g}"
    return f"the verdict is {verdict['verdict'].replace('_', ' ')}{size}"


def _number(value: float | None) -> str:
    return "-" if value is None else "a curve" if math.isnan(value) else f"{value:.4g}"


def _link(found: Path) -> str:
    return f'<p><a href="{found.name}/report.html">All of this search</a></p>'
