"""The report: one page that opens alone, says what the verdict says, and whose figures add up."""

import re
from dataclasses import replace
from functools import cache
from html import escape
from pathlib import Path

import numpy as np
import pytest
from camera_logs import STEP, Recipe, camera_log, chirp
from linear_problem import LinearProblem
from report_pages import opens_without_a_network
from rig_logs import joints_log

from saltus.effects.profile import IDEAL
from saltus.real2sim.patch import PatchEvidence, PatchRange, ProfilePatch
from saltus.real2sim.problem.camera.problem import CameraProblem
from saltus.real2sim.problem.problem import ExplanatoryVariable, Problem
from saltus.real2sim.reporting import figures
from saltus.real2sim.reporting.localise import ResidualSignal, channels_of
from saltus.real2sim.reporting.report import report_page
from saltus.real2sim.reporting.verdict_text import verdict_sentence
from saltus.real2sim.results import Judgement, LogExamination, SensorResult
from saltus.real2sim.screening.channel_scales import LogFault
from saltus.real2sim.search.findings import ModelResiduals, SearchFindings
from saltus.real2sim.search.search import search_effects
from saltus.real2sim.verdict import NextExperiment, Verdict, merge_findings
from saltus.recordings.run_log import RunLog
from saltus.reports.page import write_page

LOG = PatchEvidence(log="a <strange> name", sha256="5a" * 32)
NEXT = NextExperiment(name="joint_chirp", why="reaches 20 Hz", expected_separation=40.0)


@cache
def rig_log() -> RunLog:
    return joints_log(seconds=12.0)


@cache
def found(case: str) -> tuple[Problem, SearchFindings]:
    hidden = {
        "named": {("e1", "hip", "FR"): 3.0},
        "no_gap": {},
        "set": {("e1", "hip", "FR"): 3.0},
        "unexplained": {("e1", "hip", "FR"): 3.0},
    }[case]
    problem = LinearProblem(hidden, seed=3, alike=0.999 if case == "set" else None)
    problem.untestable = {"torque_speed_limit": "max |dq| 6.1 < 20 rad/s"}
    findings = search_effects(problem, seed=0)
    if case == "unexplained":
        findings = replace(findings, verdict="unexplained", effects=(), nearest=findings.effects)
    return problem, findings


def judged(case: str) -> Judgement:
    if case == "bad_log":
        faults = (LogFault(name="units", text="q is in degrees & not in radians"),)
        examined = LogExamination(log=rig_log(), faults=faults, untestable={})
        verdict = merge_findings((), [fault.text for fault in faults])
    else:
        problem, findings = found(case)
        compared = SensorResult(problem=problem, findings=findings, log=rig_log())
        examined = LogExamination(log=rig_log(), faults=(), untestable={}, comparisons=(compared,))
        verdict = replace(
            merge_findings([findings]), next_experiment=NEXT if case == "set" else None
        )
    return judgement(verdict, examined)


def judgement(verdict: Verdict, examined: LogExamination) -> Judgement:
    patch = ProfilePatch(effects=verdict.effects, evidence=(LOG,), range=PatchRange())
    return Judgement(
        verdict=verdict, patch=patch, examinations=(examined,), evidence=(LOG,), profile=IDEAL
    )


def page(of: Judgement, folder: Path) -> str:
    return report_page(of, seed=7)


@pytest.mark.sample(2)
@pytest.mark.parametrize("case", ["named", "set", "unexplained", "no_gap", "bad_log"])
def test_every_verdict_has_a_page_that_says_it(case: str, tmp_path: Path) -> None:
    of = judged(case)
    assert of.verdict.verdict == case
    text = page(of, tmp_path)
    said = verdict_sentence(of.verdict)
    assert f"<h1>{escape(said[0].upper() + said[1:])}</h1>" in text
    assert escape(LOG.log) in text
    assert LOG.sha256 in text
    assert "seed = 7" in text
    for name, why in of.verdict.untestable.items():
        assert name in text
        assert escape(why) in text
    for name, size in of.verdict.minimum_detectable.items():
        assert re.search(f"<td>{name}</td><td>[^<]*</td><td>{size.value:.4g}</td>", text)
    for effect in of.verdict.effects:
        for value in effect.params.values():
            assert (
                f"<td>{value.value:.4g}</td><td>{value.ci90[0]:.4g} to {value.ci90[1]:.4g}</td>"
                in text
            )
    for effect in of.verdict.nearest:
        assert f"the nearest is {effect.name} (" in said
        assert text.count("<td>nearest, not named</td>") == sum(
            len(each.params) for each in of.verdict.nearest
        )
    if case == "set":
        assert "experiments --run joint_chirp" in text
        assert escape(NEXT.why) in text


def test_a_page_needs_no_network(tmp_path: Path) -> None:
    text = page(judged("named"), tmp_path)
    write_page(tmp_path / "report.html", text)
    opens_without_a_network(tmp_path / "report.html")
    assert text.count("Plotly.newPlot(") > 5


def test_what_is_left_is_told_of_the_chosen_model(tmp_path: Path) -> None:
    problem, findings = found("named")
    assert findings.residuals is not None
    assert findings.residuals.effects == ("e1",)
    assert np.mean(findings.residuals.after**2) < 1.1 < np.mean(findings.residuals.before**2)
    assert findings.residuals.is_test.shape == problem.time_s.shape
    tests = {gap.signal: gap for gap in findings.gaps}
    for index, name in enumerate(problem.signals):
        rows = findings.residuals.is_test & (problem.signal == index)
        assert tests[name].before == pytest.approx(np.mean(findings.residuals.before[:, rows] ** 2))
        assert tests[name].after == pytest.approx(np.mean(findings.residuals.after[:, rows] ** 2))


@pytest.mark.parametrize("values", ["normal", "few", "one"])
def test_bins_lose_no_power(values: str) -> None:
    rng = np.random.default_rng(0)
    at = {
        "normal": rng.normal(size=999),
        "few": rng.integers(0, 3, 999) + 0.0,
        "one": np.ones(999),
    }[values]
    residual = rng.normal(size=999) * (1.0 + at**2)
    x, y = figures.rms_by(ExplanatoryVariable(name="tau", unit="Nm", values=at), residual)
    assert np.all(np.diff(x) > 0.0)
    assert at.min() <= x[0] <= x[-1] <= at.max()
    rms = np.sqrt(np.mean(residual**2))
    assert (1.0 - 1e-12) * y.min() <= rms <= (1.0 + 1e-12) * y.max()
    if values == "few":
        assert y == pytest.approx([np.sqrt(np.mean(residual[at == k] ** 2)) for k in range(3)])


def test_the_signals_that_are_farthest_off_come_first() -> None:
    problem, findings = found("named")
    assert findings.residuals is not None
    channels = channels_of(problem, rig_log(), findings.residuals.before)
    worst = [channels[i] for i in figures.worst_channels(channels)]
    assert (worst[0].signal, worst[0].place) == ("q", "FR_hip")
    assert len({(channel.signal, channel.place.rpartition("_")[2]) for channel in worst}) == len(
        worst
    )


def test_the_trace_shows_where_the_residual_is_largest() -> None:
    time_s = np.repeat(np.arange(0.0, 20.0, 0.02), 3)  # three pixels an image
    bump = 5.0 * np.exp(-(((time_s - 12.0) / 0.3) ** 2))
    time = ExplanatoryVariable(name=figures.TIME, unit="s", values=time_s)
    channel = ResidualSignal(signal="q", place="x", residual=bump, variables=(time,))
    shown = figures.trace_figure(channel, replace(channel, residual=0.1 * bump)).data
    x, y = np.array(shown[0].x), np.array(shown[0].y)
    assert x[0] < 11.5
    assert x[-1] > 12.5
    assert x[-1] - x[0] <= figures.TRACE_S
    assert y.max() == pytest.approx(5.0)
    assert np.array(shown[1].y).max() == pytest.approx(0.5)


def test_a_camera_s_residuals_are_shown_over_the_image(tmp_path: Path) -> None:
    log = camera_log(Recipe(boxes=STEP, motion=chirp, duration_s=4.0))
    problem = CameraProblem(log)
    nothing = np.concatenate([c.starts[0] for c in problem.candidates])[None, None]
    nothing[..., [u.is_shape is False for c in problem.candidates for u in c.unknowns]] = 0.0
    left = problem.residuals(nothing)[0]
    is_depth = problem.signal == problem.signals.index("depth")
    for variable in problem.explanatory_variables():
        assert np.isfinite(variable.values[is_depth]).all()
        assert np.isnan(variable.values[~is_depth]).all()
        assert variable.values[is_depth].min() >= 0.0
    residuals = ModelResiduals(
        before=left,
        after=left,
        unknowns=np.zeros((1, 0)),
        effects=(),
        is_test=np.ones(len(problem.signal), dtype=bool),
    )
    findings = SearchFindings(problem="camera", verdict="no_gap", residuals=residuals)
    compared = SensorResult(problem=problem, findings=findings, log=log)
    examined = LogExamination(log=log, faults=(), untestable={}, comparisons=(compared,))
    assert "Mean residual over the image" in page(
        judgement(merge_findings([findings]), examined), tmp_path
    )


def test_samples_that_are_missing_do_not_spoil_what_they_drive() -> None:
    problem, findings = found("named")
    assert findings.residuals is not None
    log = rig_log()
    torque = np.array(log.joints.tau_est)
    torque[1000:1200, 0], torque[:, 1] = np.nan, np.nan
    log = replace(log, joints=replace(log.joints, tau_est=torque))
    named = {
        (channel.place, variable.name): variable.values
        for channel in channels_of(problem, log, findings.residuals.before)
        for variable in channel.variables
    }
    assert np.isfinite(named["FR_hip", "torque"]).all()
    assert ("FR_thigh", "torque") not in named
    assert ("FL_hip", "torque") in named
