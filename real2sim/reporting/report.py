"""`report.html`: what was found, the evidence for it, and what these data cannot show.

It opens without a network. Residuals are in units of noise (sigma) and from test segments, unless the page says
otherwise.
"""

import numpy as np

from saltus.real2sim.problem.camera.problem import COLUMN, ROW
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.reporting import figures, text
from saltus.real2sim.reporting.localise import Channel, localise
from saltus.real2sim.reporting.regimes import channels_of
from saltus.real2sim.results import Comparison, Examination, Judgement
from saltus.real2sim.search.findings import Findings, Residuals
from saltus.recordings.page import figure_html, page
from saltus.recordings.run_log import RunLog

MORE_STYLE = """
h2 { border-top: 1px solid #bbb; padding-top: 0.6em; } h3 { font-size: 1em; margin: 1.5em 0 0.2em; }
table.words td, table.words th { text-align: left; vertical-align: top; }
"""
SAID_BEFORE, SAID_AFTER = 6, 3
"""Number of statements on where the gap lies, and on what is left."""


def report_page(judgement: Judgement, *, seed: int = 0) -> str:
    """The text of `report.html`; the simulator had the effects of its profile from the start."""
    verdict = judgement.verdict
    findings = [comparison.findings for each in judgement.examinations for comparison in each.comparisons]
    rivals = [rival for each in findings for rival in each.rivals]
    parts = [text.headline(verdict, judgement.profile), text.draws(judgement)]
    parts += [text.effects_table(verdict.effects, rivals, verdict.nearest)]
    if findings:
        parts += ["<h2>The gap</h2>", text.gap_paragraph(verdict.gap)]
    parts += [_examination(each, is_alone=len(judgement.examinations) == 1) for each in judgement.examinations]
    parts += ["<h2>Next</h2>", text.next_paragraph(judgement)]
    parts += ["<h2>What these data cannot show</h2>", text.untestable_table(verdict)]
    sizes = text.detectable_table(verdict, judgement.profile)
    parts += ["<h2>Smallest effects that would have been seen</h2>", sizes] if findings else []
    parts += ["<h2>Provenance</h2>", text.provenance(judgement, judgement.profile, seed)]
    return page("What the simulator lacks", "".join(parts), MORE_STYLE)


def _examination(examination: Examination, *, is_alone: bool) -> str:
    """The part on one log."""
    clocks = text.clocks(examination)
    parts = ["<h2>Clocks</h2>", clocks] if clocks else []
    return "".join([*parts, *(_comparison(comparison, is_alone) for comparison in examination.comparisons)])


def _comparison(comparison: Comparison, is_alone: bool) -> str:
    """The part on one sensor."""
    problem, findings, log = comparison.problem, comparison.findings, comparison.log
    which = "" if is_alone else f" of {', '.join(problem.blocks)}"
    parts = [f"<h2>The {problem.name}{which}: {findings.verdict.replace('_', ' ')}</h2>"]
    if findings.residuals is not None:
        parts += _residuals(problem, log, findings.residuals)
    if any(gap.before > 0.0 for gap in findings.gaps):
        parts += [
            "<h3>Each signal on segments that no fit has seen</h3>",
            _note("Root mean square in units of noise; 1 is noise alone."),
            figure_html(figures.gap_figure(findings.gaps)),
        ]
    return "".join([*parts, *_models(findings)])


def _models(findings: Findings) -> list[str]:
    """The compared models and the confusion of effects."""
    parts = []
    chosen = findings.residuals.effects if findings.residuals is not None else ()
    if any(model.effects and model.gain >= text.LEAST_NATS for model in findings.ranking):
        parts += [
            "<h3>Models that were compared</h3>",
            _note(
                "Gain on data held out from each fit, by cross-validation with intervals from a block bootstrap; "
                "beside it the share of the gap that the model closes. Green: the model that was chosen, the smallest "
                "that no larger one beats by more than chance, and whose effects are all larger than what two correct "
                "simulations differ by."
            ),
            figure_html(figures.ranking_figure(findings.ranking, chosen)),
            text.idle_models(findings.ranking),
        ]
    if len(findings.confusion.effects) > 1:
        parts += [
            "<h3>What looks alike in these data</h3>",
            _note(
                "Cosine between what two effects do to these residuals; from 0.95 on they cannot be told apart. "
                "An effect that leaves no trace has 0."
            ),
            figure_html(figures.confusion_figure(findings.confusion)),
        ]
    return parts


def _residuals(problem: Problem, log: RunLog, residuals: Residuals) -> list[str]:
    """Residuals before and after."""
    both = (residuals.before, residuals.after)
    known = (residuals.before != 0.0) | (residuals.after != 0.0)  # missing samples are 0
    whole = [channels_of(problem, log, left, known) for left in both]
    tested = [channels_of(problem, log, left, known & residuals.is_test) for left in both]
    parts = [
        "<h3>Where the gap lies</h3>",
        _note("Read off the whole log, independently of every fit. Sigma is one standard deviation of the noise."),
        text.statements(localise(whole[0]), SAID_BEFORE),
    ]
    if not np.array_equal(residuals.before, residuals.after):
        parts += [text.what_is_left(residuals.effects), text.statements(localise(whole[1]), SAID_AFTER)]
    if len({channel.place for channel in tested[0]}) > 1:
        parts += [
            "<h3>Every joint</h3>",
            _note("Root mean square of the residual in units of noise."),
            figure_html(figures.matrix_figure(*tested)),
        ]
    parts += _regimes(*tested)
    return parts


def _regimes(before: tuple[Channel, ...], after: tuple[Channel, ...]) -> list[str]:
    """The signals with the largest residuals over their drivers."""
    worst = figures.worst_channels(before)
    if not worst:
        return []
    parts = [
        "<h3>The signals that are farthest off, by regime</h3>",
        _note("One of each kind. Root mean square in bins of equal count; the dotted line is noise alone."),
        *(figure_html(figures.regime_figure(before[i], after[i])) for i in worst),
    ]
    for i in worst:
        drivers = {driver.name: driver for driver in before[i].drivers}
        if ROW in drivers:
            picture = figures.image_figure(before[i], after[i], drivers[ROW], drivers[COLUMN])
            parts += ["<h3>Mean residual over the image</h3>", figure_html(picture)]
    first = worst[0]
    parts += [
        "<h3>The two seconds that are farthest off</h3>",
        _note("Measured minus simulated, of the first of these signals; for images, the mean over their pixels."),
        figure_html(figures.trace_figure(before[first], after[first])),
    ]
    return parts


def _note(words: str) -> str:
    return f'<p class="note">{words}</p>'
