"""One HTML file that tells a cycle: what was hidden,
what was found, what training with it is worth.
"""

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from markupsafe import Markup

from saltus.heightmap.data.shards import read_records
from saltus.policy.evaluation.evaluate import merge_batches, success_interval
from saltus.policy.evaluation.trial_pictures import picture_strip
from saltus.provenance import current_commit
from saltus.real2sim.cycle.choosing import DRIVES, choice_text, read_choice
from saltus.real2sim.cycle.finding import gaps_of, not_applied
from saltus.real2sim.cycle.folder import MODELS, CycleFolder
from saltus.real2sim.cycle.hidden_and_found import TruthRow, truth_rows
from saltus.real2sim.cycle.measuring import (
    MOMENTS,
    NOT_MEASURED,
    BeforeOrAfter,
    MeasuredCourse,
    known_of,
    models_of,
    read_measurement,
)
from saltus.real2sim.cycle.settings import CycleSettings
from saltus.real2sim.cycle.trials import COURSES, run_trials, trials_of
from saltus.real2sim.reporting.figures import gap_figure
from saltus.real2sim.reporting.verdict_text import by_reason
from saltus.reports.figures import BLUE, GREEN, GREY, RED, laid_out
from saltus.reports.page import render_page, write_page
from saltus.used_networks import ModelKind

MeasuredCourses = dict[str, dict[BeforeOrAfter, MeasuredCourse]]


def cycle_results(folder: CycleFolder) -> dict[str, object]:
    """Returns what a program would read of a cycle."""
    courses, choice = _courses(folder), read_choice(folder)
    return {
        "report": str(folder.report),
        "profile": str(folder.profile),
        "found": _verdict(folder.found),
        "again": _verdict(folder.again),
        "effects": [asdict(row) for row in truth_rows(folder)],
        "not_applied": not_applied(folder),
        "models": training_results(folder),
        "choice": None
        if choice is None
        else asdict(choice) | {"taken": choice.taken, "drives": DRIVES in choice.best},
        "courses": {
            course: {
                when: {
                    "successes": trials.successes,
                    "trials": len(trials.failures),
                    "models": trials.models,
                }
                for when, trials in done.items()
            }
            for course, done in courses.items()
        },
    }


def training_results(folder: CycleFolder) -> dict[ModelKind, str]:
    """Reads what became of each model; nothing where training is not over."""
    became: dict[ModelKind, str] = (
        json.loads(folder.trained.read_text(encoding="utf-8")) if folder.trained.exists() else {}
    )
    return became


def write_cycle_report(folder: CycleFolder, settings: CycleSettings) -> None:
    """Writes the report of what is done so far; it opens without a network."""
    rows, courses = truth_rows(folder), _courses(folder)
    hidden = [row for row in rows if row.true is not None and row.true != row.known]
    found, again = _verdict(folder.found), _verdict(folder.again)
    before, after = gaps_of(folder.found), gaps_of(folder.again)
    shown = [
        replace(gap, after=after[name].before if name in after else gap.before)
        for name, gap in before.items()
    ]
    untestable = {each["name"]: each["why"] for each in (found or {})["untestable"]}
    text = render_page(
        __file__,
        folder=folder,
        headline=_headline(rows, hidden, courses),
        truth=truth_figure(hidden) if hidden else None,
        effects=[_cells(row) for row in rows],
        not_applied=not_applied(folder),
        found=_words(found),
        again=_words(again) if again else "",
        gaps=gap_figure(shown) if shown else None,
        trained=training_results(folder),
        data_ticks=sum(record.ticks for record in read_records(folder.dataset))
        if folder.dataset.exists()
        else None,
        updates=settings.predictor.updates,
        choice=read_choice(folder),
        course_names=tuple(COURSES),
        named=_named,
        choices=_choices(folder),
        successes=success_figure(courses) if courses else None,
        failures=[
            (course, when, f"{trials.successes} of {len(trials.failures)}", _causes(trials))
            for course, done in courses.items()
            for when, trials in done.items()
        ],
        not_measured="Not measured yet." if folder.hidden.exists() else NOT_MEASURED,
        strips=_pictures(folder, settings, courses),
        untestable=by_reason(untestable),
        commit=current_commit(),
        settings=folder.settings.read_text(encoding="utf-8"),
    )
    write_page(folder.report, text)


def _courses(folder: CycleFolder) -> MeasuredCourses:
    """Returns what was measured so far."""
    pairs = {
        course: {when: read_measurement(folder, when, course) for when in MOMENTS}
        for course in COURSES
    }
    return {
        course: known
        for course, done in pairs.items()
        if (
            known := {
                when: trials
                for when, trials in done.items()
                if trials is not None and trials.failures
            }
        )
    }


def _verdict(found: Path) -> dict[str, Any] | None:
    path = found / "verdict.json"
    verdict: dict[str, Any] | None = (
        json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
    )
    return verdict


def _headline(rows: list[TruthRow], hidden: list[TruthRow], courses: MeasuredCourses) -> str:
    found = sum(row.found is not None for row in hidden)
    said = [
        f"{found} of {len(hidden)} hidden parameters found"
        if hidden
        else f"{len(rows)} parameters found"
    ]
    whole = [done for done in courses.values() if len(done) == len(MOMENTS)]
    for when in MOMENTS:
        trials = [done[when] for done in whole]
        if trials:
            share = sum(each.successes for each in trials) / sum(
                len(each.failures) for each in trials
            )
            said.append(f"{share:.0%} of all trials succeed {when}")
    return f"The cycle: {'; '.join(said)}"


def _cells(row: TruthRow) -> tuple[str, ...]:
    """A row of the table of effects."""
    interval = "-" if row.ci90 is None else f"{_number(row.ci90[0])} to {_number(row.ci90[1])}"
    values = (_number(value) for value in (row.known, row.true, row.found))
    return (row.effect, row.where, row.parameter, row.unit, *values, interval, row.remark)


def _choices(folder: CycleFolder) -> str:
    """Which of the trained models were taken, and why."""
    choice = read_choice(folder)
    if choice is None:
        return ""
    said = [
        f"{kind} model {choice_text(choice, kind)}" for kind in MODELS if str(kind) in choice.models
    ]
    if any(DRIVES in pair for pair in choice.tallies):
        said.append(
            "the leg controller "
            + ("makes up for the drives" if DRIVES in choice.best else "stays as it was")
        )
    return "; ".join(said)


def _named(pair: str) -> str:
    """New parts of a pair, in words."""
    names = [name for name in pair.split("+") if name]
    models = " and ".join(name for name in names if name != DRIVES)
    words = [
        f"trained {models}" if models else "as shipped",
        *(["drives made up for"] if DRIVES in names else []),
    ]
    return ", ".join(words)


def _causes(trials: MeasuredCourse) -> str:
    causes = Counter(cause for cause in trials.failures.values() if cause)
    return (
        ", ".join(f"{count} {cause.replace('_', ' ')}" for cause, count in causes.most_common())
        or "-"
    )


def _pictures(
    folder: CycleFolder, settings: CycleSettings, courses: MeasuredCourses
) -> list[Markup]:
    """One trial before and after, on the course where most changed.

    There the first that failed before.
    """
    gains = {
        c: done["after"].successes - done["before"].successes
        for c, done in courses.items()
        if len(done) == 2
    }
    if not gains:
        return []
    course = max(gains, key=lambda name: gains[name])
    before = courses[course]["before"].failures
    seed = next((seed for seed, cause in before.items() if cause), next(iter(before)))
    return [
        _strip(folder, settings, courses[course][when], when, course, int(seed)) for when in MOMENTS
    ]


def _strip(
    folder: CycleFolder,
    settings: CycleSettings,
    trials: MeasuredCourse,
    when: BeforeOrAfter,
    course: str,
    seed: int,
) -> Markup:
    """Pictures of a trial, which is run again for them once."""
    kept = (
        folder.measured
        / f"{when}-{course.partition(' ')[0]}-{seed}-{'-'.join(trials.models.values())}.html"
    )
    if not kept.exists():
        models = models_of(folder, when)
        robot = (settings.loop, folder.hidden, known_of(folder, when))
        evaluation = trials_of(*robot, course, seed, 1)
        trial = merge_batches(run_trials(models, evaluation)).trials[0]
        ended = trial.failure.replace("_", " ") or "success"
        pictures = picture_strip(evaluation.setups([seed])[0], trial.trace)
        head = Markup("<h3>{}, seed {}, {}: {}</h3>").format(course, seed, when, ended)
        kept.write_text(head + pictures, encoding="utf-8")
    return Markup(kept.read_text(encoding="utf-8"))  # noqa: S704 # written above


def _words(verdict: dict[str, Any] | None) -> str:
    if verdict is None:
        return "not searched"
    gap = verdict["gap"]
    size = (
        ""
        if gap is None
        else f", mean squared residual {gap['before']:.3g} where noise alone is {gap['floor']:.3g}"
    )
    return f"the verdict is {verdict['verdict'].replace('_', ' ')}{size}"


def _number(value: float | None) -> str:
    return "-" if value is None else "a curve" if math.isnan(value) else f"{value:.4g}"


COLOURS: dict[BeforeOrAfter, str] = {"before": RED, "after": BLUE}


def success_figure(courses: Mapping[str, Mapping[BeforeOrAfter, MeasuredCourse]]) -> go.Figure:
    """Share of trials that succeeded on each course before and after, with 95 % intervals."""
    figure = go.Figure()
    for when in MOMENTS:
        done = {course: measured[when] for course, measured in courses.items() if when in measured}
        counts = [(trials.successes, len(trials.failures)) for trials in done.values()]
        share = np.array([100 * hits / count for hits, count in counts])
        low, high = 100 * np.array([success_interval(*count) for count in counts]).reshape(-1, 2).T
        figure.add_bar(
            x=list(done), y=share, name=f"{when}", marker_color=COLOURS[when],
            text=[f"{hits} of {count}" for hits, count in counts], textposition="inside",
            insidetextanchor="start",
            error_y={"type": "data", "symmetric": False, "array": high - share,
                "arrayminus": share - low},
        )  # fmt: skip
    figure.update_yaxes(range=[0, 104])
    return laid_out(figure, 380, y="trials that succeeded [%]", legend_y=1.12, barmode="group")


def truth_figure(rows: Sequence[TruthRow]) -> go.Figure:
    """Draws what was found of each hidden change, as a share of it:
    0 is what was known, 100 % is the truth.
    """
    figure = go.Figure()
    shares = [_shares(row) for row in rows]
    names = [row.name for row in rows]
    found = [(name, share) for name, share in zip(names, shares, strict=True) if share is not None]
    figure.add_scatter(
        x=[middle for _, (_, middle, _) in found], y=[name for name, _ in found], mode="markers",
        name="found",
        marker={"color": BLUE, "size": 11},
        error_x={
            "type": "data", "symmetric": False,
            "array": [high - middle for _, (_, middle, high) in found],
            "arrayminus": [middle - low for _, (low, middle, _) in found],
        },
    )  # fmt: skip
    missed = [name for name, share in zip(names, shares, strict=True) if share is None]
    figure.add_scatter(
        x=[0.0] * len(missed), y=missed, mode="markers", name="not found",
        marker={"color": RED, "size": 11, "symbol": "x"},
    )  # fmt: skip
    figure.add_vline(x=100.0, line={"color": GREEN, "width": 2})
    figure.add_vline(x=0.0, line={"color": GREY, "dash": "dot", "width": 1})
    figure.update_yaxes(
        autorange="reversed", type="category", categoryorder="array", categoryarray=names
    )
    return laid_out(
        figure, 130 + 34 * len(rows),
        x="of the hidden change [%], with 90 % intervals; green: the truth",
        margin={"l": 260, "r": 20, "t": 40, "b": 50},
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom"},
    )  # fmt: skip


def _shares(row: TruthRow) -> tuple[float, float, float] | None:
    """Lower end, value and upper end of what was found, in % of the change;
    None where nothing was found.
    """
    if row.found is None or row.ci90 is None or row.true is None or row.known is None:
        return None
    change = 0.01 * (row.true - row.known)
    low, middle, high = (
        (value - row.known) / change for value in (row.ci90[0], row.found, row.ci90[1])
    )
    return min(low, high), middle, max(low, high)
