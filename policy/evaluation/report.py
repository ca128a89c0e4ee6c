"""One HTML file about an evaluation: how often, how fast,
where the feet were, and why trials failed.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from saltus.config import to_toml
from saltus.policy.evaluation.evaluate import EvaluationResult, EvaluationSettings, TrialResult
from saltus.policy.evaluation.trial_pictures import picture_strip
from saltus.provenance import current_commit
from saltus.recordings.report import course_title
from saltus.recordings.summary import number_text
from saltus.reports.figures import BLUE, GREEN, RED, contact_figure, ground_figure, laid_out
from saltus.reports.page import render_page, write_page
from saltus.terrain.terrain import Terrain

SHOWN = 20  # trials whose curves are drawn: more would hide each other
BEHIND_M, AHEAD_M = 0.6, 1.0  # of the start and of the finish


def write_evaluation_report(
    evaluation: EvaluationSettings, result: EvaluationResult, table: dict[str, object], path: Path
) -> None:
    """Writes the report of an evaluation, whose result is printed as `table`.

    It opens without a network.
    """
    drawn = result.trials[:SHOWN]
    setups = evaluation.setups(result.seeds[:SHOWN])
    terrains = [setup.terrain for setup in setups]
    text = render_page(
        __file__,
        result=result,
        printed=table,
        shown=number_text,
        course=course_title(terrains[0]),
        alike=f"of the first {len(drawn)} trials"
        if len(drawn) < len(result.trials)
        else "of all trials",
        placement=_placement(drawn, terrains),
        strip=picture_strip(setups[0], drawn[0].trace),
        body_curves=_body(drawn),
        phase=_phase(drawn),
        gait=_gait(drawn[0]),
        failures=[
            (cause.replace("_", " "), count, _places(result, cause))
            for cause, count in _worst_first(result)
        ],
        commit=current_commit(),
        config=to_toml(evaluation),
    )
    write_page(path, text)


def _worst_first(result: EvaluationResult) -> list[tuple[str, int]]:
    return sorted(result.failures.items(), key=lambda item: -item[1])


def _places(result: EvaluationResult, cause: str) -> str:
    """Seeds and where along the course the robot was at the end
    of trials that failed by this cause.
    """
    pairs = zip(result.seeds, result.trials, strict=True)
    return ", ".join(
        f"{seed} at {trial.trace.base[-1, 0]:.1f} m"
        for seed, trial in pairs
        if trial.failure == cause
    )


def _lines(
    figure: go.Figure, trial: TrialResult, x: object, y: object, opacity: float, **more: object
) -> None:
    """A curve of a trial, which may be of hundreds: green where it succeeded, else red."""
    figure.add_scattergl(
        x=x, y=y, mode="lines", showlegend=False, opacity=opacity,
        line={"color": GREEN if trial.outcome.success else RED, "width": 1}, **more,
    )  # fmt: skip


def _placement(trials: Sequence[TrialResult], terrains: Sequence[Terrain]) -> go.Figure:
    figure = go.Figure()
    for terrain in {id(terrain): terrain for terrain in terrains}.values():
        figure.add_traces(ground_figure(terrain, -BEHIND_M, terrain.finish_x + AHEAD_M).data)
    figure.update_traces(showlegend=False)
    for trial in trials:
        x, z = trial.trace.base.T
        _lines(figure, trial, x, z, 0.5, hoverinfo="skip")
    x, z = np.concatenate([trial.trace.landings for trial in trials]).T
    figure.add_scattergl(
        x=x, y=z, name="landings", mode="markers", marker={"color": BLUE, "size": 4}
    )
    figure.update_yaxes(scaleanchor="x", scaleratio=1)
    return laid_out(figure, 430, x="x [m]", y="z [m]", legend_y=1.12)


def _body(trials: Sequence[TrialResult]) -> go.Figure:
    figure = go.Figure()
    for trial in trials:
        x, z = trial.trace.base.T
        _lines(figure, trial, x, z, 0.6, yaxis="y")
        _lines(figure, trial, x, np.degrees(trial.trace.pitch), 0.6, yaxis="y2")
    return laid_out(
        figure, 430, xaxis={"title": "x [m]", "anchor": "y2"},
        yaxis={"domain": [0.54, 1.0], "title": "z [m]"},
        yaxis2={"domain": [0.0, 0.46], "title": "pitch [deg], nose down positive"},
    )  # fmt: skip


def _phase(trials: Sequence[TrialResult]) -> go.Figure:
    figure = go.Figure()
    for trial in trials:
        pitch = trial.trace.pitch
        if len(pitch) > 1:
            _lines(figure, trial, np.degrees(pitch), np.gradient(pitch, trial.trace.time_s), 0.4)
    return laid_out(figure, 430, x="pitch [deg]", y="pitch rate [rad/s]")


def _gait(trial: TrialResult) -> go.Figure:
    """Gait of a pair of feet, of which either may stand and either may bear load."""
    trace = trial.trace
    stance, loaded = (
        np.any(mask.reshape(-1, 2, 2), axis=-1) for mask in (trace.stance, trace.loaded)
    )
    return contact_figure(trace.time_s, ("front feet", "rear feet"), stance, loaded)
