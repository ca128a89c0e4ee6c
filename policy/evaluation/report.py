"""One HTML file about an evaluation: how often, how fast, where the feet were, and why trials failed."""

import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from saltus.config import to_toml
from saltus.policy.evaluation.evaluate import Evaluation, EvaluationResult, TrialResult, courses_of
from saltus.policy.evaluation.pictures import picture_strip
from saltus.provenance import commit
from saltus.recordings.page import figure_html, page, table, write_page
from saltus.recordings.report import (
    BLUE,
    GREEN,
    RED,
    add_ground,
    contact_figure,
    course_title,
)
from saltus.recordings.summary import shown
from saltus.robots.loading import load_robot
from saltus.terrain.terrain import Terrain

SHOWN = 20  # trials whose curves are drawn: more would hide each other
BEHIND_M, AHEAD_M = 0.6, 1.0  # of the start and of the finish


def write_evaluation_report(
    evaluation: Evaluation, result: EvaluationResult, table: dict[str, Any], path: Path
) -> None:
    """Writes the report of an evaluation, whose result is printed as `table`; it opens without a network."""
    shown = result.trials[:SHOWN]
    terrains = courses_of(evaluation.course, result.seeds[:SHOWN])
    alike = f"of the first {len(shown)} trials" if len(shown) < len(result.trials) else "of all trials"
    course = html.escape(course_title(terrains[0]))
    parts = [
        f"<h1>{result.successes} of {len(result.trials)} trials succeeded: {course}</h1>",
        _numbers(table),
        f"<h2>Where feet landed, and the way of the trunk, {alike}</h2>",
        figure_html(_placement(shown, terrains)),
        f"<h2>Seed {result.seeds[0]}, from the first jump to the end</h2>",
        picture_strip(load_robot(evaluation.robot), terrains[0], shown[0].trace),
        f"<h2>Height and pitch of the trunk along the course, {alike}</h2>",
        figure_html(_body(shown)),
        f"<h2>Phase diagram: pitch and its rate, {alike}</h2>",
        figure_html(_phase(shown)),
        "<h2>Contact schedule and loaded feet of the first trial</h2>",
        figure_html(_gait(shown[0])),
        "<h2>Failures by cause</h2>",
        _failures(result),
        "<h2>Provenance</h2>",
        f"<pre>{html.escape(_provenance(evaluation, table))}</pre>",
    ]
    write_page(path, page("Saltus evaluation", "\n".join(parts)))


def _provenance(evaluation: Evaluation, table: dict[str, Any]) -> str:
    named = ("planner", "heightmap", "camera")
    lines = [f"{name} = {table[name]}" for name in named if table[name] is not None]
    lines += [f"{kind} model = {name}" for kind, name in table["models"].items()]
    return "\n".join([f"commit = {commit()}", *lines, to_toml(evaluation)])


def _numbers(result: dict[str, Any]) -> str:
    rows = {
        "planner": result["planner"],
        "heightmap": result["heightmap"],
        "success, with its 95 % interval": _share(result["success_rate"], *result["success_interval95"]),
        f"median time of successes, {result['timed']}": shown(result["time_s"]["p50"], 2, "s"),
        "mean speed of successes in that time": shown(result["mean_speed_mps"], 2, "m/s"),
        "seeds": f"{result['seed']} to {result['seed'] + result['trials'] - 1}",
    }
    return table((), rows.items())


def _share(share: float, low: float, high: float) -> str:
    return f"{100 * share:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def _placement(trials: Sequence[TrialResult], terrains: Sequence[Terrain]) -> go.Figure:
    figure = go.Figure()
    for terrain in {id(terrain): terrain for terrain in terrains}.values():
        add_ground(figure, terrain, -BEHIND_M, terrain.finish_x + AHEAD_M)
    figure.update_traces(showlegend=False)
    for trial in trials:
        colour = GREEN if trial.outcome.success else RED
        figure.add_scattergl(
            x=trial.trace.base[:, 0], y=trial.trace.base[:, 1], showlegend=False, mode="lines", hoverinfo="skip",
            line={"color": colour, "width": 1}, opacity=0.5,
        )  # fmt: skip
    landings = np.concatenate([trial.trace.landings for trial in trials])
    figure.add_scattergl(
        x=landings[:, 0], y=landings[:, 1], name="landings", mode="markers", marker={"color": BLUE, "size": 4}
    )
    figure.update_xaxes(title="x [m]")
    figure.update_yaxes(title="z [m]", scaleanchor="x", scaleratio=1)
    figure.update_layout(height=430, legend={"orientation": "h", "y": 1.12})
    return figure


def _body(trials: Sequence[TrialResult]) -> go.Figure:
    figure = go.Figure()
    for trial in trials:
        colour = GREEN if trial.outcome.success else RED
        curves = ((trial.trace.base[:, 1], "y"), (np.degrees(trial.trace.pitch), "y2"))
        for values, axis in curves:
            figure.add_scattergl(
                x=trial.trace.base[:, 0], y=values, yaxis=axis, mode="lines", showlegend=False,
                line={"color": colour, "width": 1}, opacity=0.6,
            )  # fmt: skip
    figure.update_layout(
        height=430, xaxis={"title": "x [m]", "anchor": "y2"}, yaxis={"domain": [0.54, 1.0], "title": "z [m]"},
        yaxis2={"domain": [0.0, 0.46], "title": "pitch [deg], nose down positive"},
    )  # fmt: skip
    return figure


def _phase(trials: Sequence[TrialResult]) -> go.Figure:
    figure = go.Figure()
    for trial in trials:
        if len(trial.trace.pitch) > 1:
            rate = np.gradient(trial.trace.pitch, trial.trace.time_s)
            colour = GREEN if trial.outcome.success else RED
            figure.add_scattergl(
                x=np.degrees(trial.trace.pitch), y=rate, mode="lines", showlegend=False,
                line={"color": colour, "width": 1}, opacity=0.4,
            )  # fmt: skip
    figure.update_xaxes(title="pitch [deg]")
    figure.update_yaxes(title="pitch rate [rad/s]")
    figure.update_layout(height=430)
    return figure


def _gait(trial: TrialResult) -> go.Figure:
    """Of a pair of feet either may stand, and either may bear load."""
    trace = trial.trace
    stance, loaded = (np.any(mask.reshape(-1, 2, 2), axis=-1) for mask in (trace.stance, trace.loaded))
    return contact_figure(trace.time_s, ("front feet", "rear feet"), stance, loaded)


def _failures(result: EvaluationResult) -> str:
    if not result.failures:
        return "<p>none</p>"
    rows = []
    for cause, count in sorted(result.failures.items(), key=lambda item: -item[1]):
        pairs = [(s, t) for s, t in zip(result.seeds, result.trials, strict=True) if t.failure == cause]
        where = ", ".join(f"{seed} at {trial.trace.base[-1, 0]:.1f} m" for seed, trial in pairs)
        rows.append((cause.replace("_", " "), count, where))
    return table(("cause", "trials", "seeds"), rows, "text")
