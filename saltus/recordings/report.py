"""One HTML file about one recorded run: what happened, in pictures."""

import html
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from saltus.config import RunConfig, to_toml
from saltus.constants import LOADED_N
from saltus.provenance import commit
from saltus.recordings.page import figure_html, page, table, write_page
from saltus.recordings.recording import Recording
from saltus.recordings.summary import RunSummary, shown
from saltus.robots.robot import LEGS
from saltus.terrain.terrain import Terrain
from saltus.wire.messages import (
    ControllerMode,
    Event,
    Floats,
    GroundTruth,
    Heightmap,
    HeightmapStatus,
    MotionPlan,
    RobotState,
)

# Okabe and Ito's palette: told apart by colour-blind readers
BLUE, ORANGE, GREEN, RED, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#555555"
Mask = NDArray[np.bool_]
PROFILE_EVERY = 10  # steps between the profiles that are drawn: more would hide each other
MOST_POINTS = 2000  # of a curve; a page is 1100 pixels wide


@dataclass(frozen=True, kw_only=True)
class RunData:
    """The messages of a run as arrays, joined by step; n is the number of steps that have a state and a truth."""

    time_s: Floats
    """Shape (n,), since `start_ns`."""
    start_ns: int
    """Time of the first state in the run's clock: the zero of every time that is shown."""
    position: Floats
    """True base position in the world [m], shape (n, 3)."""
    quaternion: Floats
    """True orientation, shape (n, 4)."""
    states: list[RobotState]
    truths: list[GroundTruth]
    heightmaps: dict[int, Heightmap]
    plans: dict[int, MotionPlan]


def collect(recording: Recording) -> RunData:
    """Joins the messages of a recording by step."""
    states = {m.step: m for m in recording.of(RobotState)}
    truths = {m.step: m for m in recording.of(GroundTruth)}
    steps = sorted(states.keys() & truths.keys())
    start = states[steps[0]].time_ns if steps else 0
    return RunData(
        time_s=np.array([(states[k].time_ns - start) * 1e-9 for k in steps]),
        start_ns=start,
        position=np.array([truths[k].position_base_in_world for k in steps]).reshape(-1, 3),
        quaternion=np.array([truths[k].quaternion_base_in_world for k in steps]).reshape(-1, 4),
        states=[states[k] for k in steps],
        truths=[truths[k] for k in steps],
        heightmaps={m.step: m for m in recording.of(Heightmap)},
        plans={m.step: m for m in recording.of(MotionPlan)},
    )


def write_report(recording: Recording, summary: RunSummary, path: Path, video: Path | None = None) -> None:
    """Writes the report of a run; it opens without a network. It shows the video, which may be yet to be written."""
    config = recording.known_config
    data = collect(recording)
    terrain = recording.terrain
    scheduled = np.array([state.leg_contact for state in data.states], dtype=bool).reshape(-1, 4)
    loaded = np.array([truth.foot_force for truth in data.truths]).reshape(-1, 4) > LOADED_N
    parts = [
        f"<h1>{html.escape(_headline(summary, terrain, config))}</h1>",
        _numbers(summary),
        _files(path, recording.path, video),
        "<h2>Terrain, path of the base, and what the robot thought was ahead</h2>",
        '<p class="note">Dots: predicted heights, one profile in ten; zoom in to see single profiles.</p>',
        figure_html(_path_figure(data, terrain)),
        "<h2>Height, pitch and speed of the base</h2>",
        figure_html(_body_figure(data)),
        "<h2>Contact schedule and measured contact</h2>",
        '<p class="note">Blue: a leg is scheduled to stand. Orange: its foot bears more than 5 N.</p>',
        figure_html(contact_figure(data.time_s, LEGS, scheduled, loaded)),
        "<h2>Heightmap error by distance ahead of the base</h2>",
        '<p class="note">Ground nearer than the camera sees is remembered.</p>',
        figure_html(_error_figure(data)),
        "<h2>Rates and ages</h2>",
        _timing_table(summary),
        "<h2>Events</h2>",
        _event_table(recording, data.start_ns),
        "<h2>Provenance</h2>",
        f"<pre>{html.escape(_provenance(summary, config))}</pre>",
    ]
    lost = "".join(f'<p class="bad">Lost: {html.escape(item)}</p>' for item in recording.lost)
    write_page(path, page("Saltus run", lost + "\n".join(parts)))


def _files(report: Path, recording: Path, video: Path | None) -> str:
    """What lies with a report: the video to look at, the recording to look into."""
    shown = (
        ""
        if video is None
        else f'<video controls preload="metadata" width="960" src="{_beside(report, video)}" '
        f'poster="{_beside(report, video.with_suffix(".png"))}"></video>'  # which the video brings along
    )
    link = f'<a href="{_beside(report, recording)}">{html.escape(recording.name)}</a>'
    return f"{shown}<p>All that was said: {link}. <code>saltus watch {html.escape(str(recording))}</code> plays it.</p>"


def _beside(report: Path, file: Path) -> str:
    return html.escape(quote(os.path.relpath(file, report.parent)))


def _provenance(summary: RunSummary, config: RunConfig) -> str:
    models = "".join(f"{kind} model = {name}\n" for kind, name in summary.models.items())
    return f"commit = {commit()}\ndigest = {summary.digest}\n{models}camera = {summary.camera}\n\n{to_toml(config)}"


def _headline(summary: RunSummary, terrain: Terrain, config: RunConfig) -> str:
    where = course_title(terrain)
    speed = f" at {config.speed:g} of real time" if config.speed < 1.0 else ""
    run = f"seed {config.seed}, {config.pace}{speed}"
    if summary.success:
        return f"Crossed {where} in {summary.time_s:.2f} s at {summary.mean_speed_mps:.2f} m/s; {run}"
    return f"Did not cross {where}: {summary.explanation}; {shown(summary.distance_m, 2, 'm')}, {run}"


def course_title(terrain: Terrain) -> str:
    """A terrain in words: its kind and its sizes."""
    sizes = ", ".join(_size(name, value) for name, value in terrain.params.items())
    return f"{terrain.kind.replace('_', ' ')} ({sizes})" if sizes else terrain.kind


def _size(name: str, value: float) -> str:
    if isinstance(value, int):
        return f"{value} {name}"
    size, _, unit = name.rpartition("_")
    return f"{size.replace('_', ' ')} {value:g} {unit}" if unit in ("m", "deg") and size else f"{name} {value:g}"


def _numbers(summary: RunSummary) -> str:
    rows = {
        "outcome": "success" if summary.success else "failure",
        "distance from the start": shown(summary.distance_m, 2, "m"),
        f"time {summary.timed}": shown(summary.time_s, 2, "s"),
        "mean speed in that time": shown(summary.mean_speed_mps, 2, "m/s"),
        "heightmap, mean absolute error while running": shown(100 * summary.heightmap_mae_m, 1, "cm"),
        "messages rejected": str(sum(summary.rejected.values())),
    }
    return table((), rows.items())


def _path_figure(data: RunData, terrain: Terrain) -> go.Figure:
    x_end = float(data.position[:, 0].max()) + 1.0 if len(data.position) else 1.0
    figure = go.Figure()
    add_ground(figure, terrain, -0.6, x_end)
    for status, colour in (
        (HeightmapStatus.OK, GREEN),
        (HeightmapStatus.WARMING, ORANGE),
        (HeightmapStatus.DEGRADED, RED),
    ):
        x, z = _predicted_points(data, status)
        if len(x):
            name = f"predicted heights ({status.name.lower()})"
            figure.add_scattergl(
                x=x, y=z, mode="markers", name=name, marker={"color": colour, "size": 3, "opacity": 0.5}
            )
    way = data.position[:: _stride(len(data.position))]
    figure.add_scatter(x=way[:, 0], y=way[:, 2], name="base", line={"color": BLUE, "width": 2})
    figure.update_xaxes(title="x [m]")
    figure.update_yaxes(title="z [m]", scaleanchor="x", scaleratio=1)
    figure.update_layout(height=430, legend={"orientation": "h", "y": 1.12})
    return figure


def _predicted_points(data: RunData, status: HeightmapStatus) -> tuple[Floats, Floats]:
    """World x and z of the predicted points of every tenth step."""
    xs, zs = [], []
    for truth in data.truths[:: PROFILE_EVERY * _stride(len(data.truths))]:
        heightmap = data.heightmaps.get(truth.step)
        if heightmap is None or heightmap.status != status:
            continue
        cos_yaw = np.cos(_yaw(truth.quaternion_base_in_world))
        xs.append(truth.position_base_in_world[0] + cos_yaw * np.asarray(heightmap.x))
        zs.append(truth.position_base_in_world[2] + np.asarray(heightmap.height))
    empty = np.zeros(0)
    return (np.concatenate(xs), np.concatenate(zs)) if xs else (empty, empty)


def _stride(count: int) -> int:
    """Which of so many points of a curve are drawn: all, or every second one, and so on."""
    return max(1, -(-count // MOST_POINTS))


def _yaw(quaternion: Floats) -> float:
    w, x, y, z = quaternion
    return float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def _body_figure(data: RunData) -> go.Figure:
    w, x, y, z = data.quaternion.T if len(data.quaternion) else np.zeros((4, 0))
    pitch = np.degrees(np.arcsin(np.clip(2 * (w * y - z * x), -1, 1)))
    speed = np.array([truth.velocity_base_in_world[0] for truth in data.truths])
    estimate = np.array([state.velocity_base_in_world[0] for state in data.states])
    figure = go.Figure()
    some = slice(None, None, _stride(len(data.time_s)))
    rows = (("height z [m]", data.position[:, 2], BLUE, "y"), ("pitch [deg], nose down positive", pitch, ORANGE, "y2"))
    for name, values, colour, axis in rows:
        figure.add_scatter(x=data.time_s[some], y=values[some], name=name, yaxis=axis, line={"color": colour})
    for name, values, line in (
        ("forward speed [m/s]", speed, {"color": GREEN}),
        ("its estimate [m/s]", estimate, {"color": GREEN, "dash": "dot"}),
    ):
        figure.add_scatter(x=data.time_s[some], y=values[some], name=name, yaxis="y3", line=line)
    figure.update_layout(
        height=520, legend={"orientation": "h", "y": 1.08}, xaxis={"title": "time [s]", "anchor": "y3"},
        yaxis={"domain": [0.70, 1.0], "title": "z [m]"}, yaxis2={"domain": [0.36, 0.64], "title": "pitch [deg]"},
        yaxis3={"domain": [0.0, 0.30], "title": "speed [m/s]"},
    )  # fmt: skip
    return figure


def contact_figure(time_s: Floats, legs: Sequence[str], scheduled: Mask, loaded: Mask) -> go.Figure:
    """Lines where legs, or pairs of them, are scheduled to stand, and below where they bear load; shape (n, legs)."""
    figure = go.Figure()
    for index, leg in enumerate(legs):
        level = float(len(legs) - index)
        for mask, colour, shift, name in ((scheduled, BLUE, 0.12, "scheduled"), (loaded, ORANGE, -0.12, "measured")):
            kept = _around_changes(mask[:, index])
            line = np.where(mask[kept, index], level + shift, np.nan)
            figure.add_scatter(
                x=time_s[kept], y=line, mode="lines", name=name, showlegend=index == 0, connectgaps=False,
                line={"color": colour, "width": 7}, hoverinfo="skip", text=leg,
            )  # fmt: skip
    levels = list(range(len(legs), 0, -1))
    figure.update_yaxes(tickvals=levels, ticktext=list(legs), range=[0.5, len(legs) + 0.5])
    figure.update_xaxes(title="time [s]")
    figure.update_layout(height=100 + 40 * len(legs), legend={"orientation": "h", "y": 1.2})
    return figure


def _around_changes(mask: Mask) -> NDArray[np.intp]:
    """The samples that a line needs which is drawn where a mask, shape (n,), holds: first, last, and at each change."""
    changes = np.flatnonzero(mask[1:] != mask[:-1])
    return np.unique(np.concatenate([[0], changes, changes + 1, [len(mask) - 1]])) if len(mask) else changes


def add_ground(figure: go.Figure, terrain: Terrain, start_x: float, end_x: float) -> None:
    """Draws the terrain along y = 0, with its walls upright."""
    x = np.unique(np.concatenate([np.linspace(start_x, end_x, 2000), terrain.edges_x - 1e-6, terrain.edges_x]))
    x = x[(x >= start_x) & (x <= end_x)]
    figure.add_scatter(x=x, y=terrain.height_at(x, 0.0), name="terrain", line={"color": GREY, "width": 1.5})


def _error_figure(data: RunData) -> go.Figure:
    """Of the steps that the headline's error is of: the robot runs, on a heightmap of status OK."""
    running = [t for t, s in zip(data.truths, data.states, strict=True) if s.mode == ControllerMode.RUN]
    pairs = [(data.heightmaps[t.step], t) for t in running if t.step in data.heightmaps]
    trusted = [(h, t) for h, t in pairs if h.status == HeightmapStatus.OK]
    figure = go.Figure()
    if trusted:
        x = 100 * np.asarray(trusted[0][0].x)
        error = 100 * np.abs(np.array([np.asarray(h.height) - t.height for h, t in trusted]))
        claimed = 100 * np.median([np.asarray(h.half_width_90) for h, _ in trusted], axis=0)
        for name, values, colour in (
            ("median error", np.median(error, axis=0), BLUE),
            ("90 % of errors are below", np.quantile(error, 0.9, axis=0), RED),
            ("half of the 90 % interval that the model states, median", claimed, GREY),
        ):
            figure.add_scatter(x=x, y=values, name=name, mode="lines+markers", line={"color": colour})
    figure.update_xaxes(title="distance ahead of the base [cm]")
    figure.update_yaxes(title="[cm]", rangemode="tozero")
    figure.update_layout(height=330, legend={"orientation": "h", "y": 1.15})
    return figure


def _timing_table(summary: RunSummary) -> str:
    rows = [
        (topic, f"{rate:.1f}", *(f"{summary.age_ms[topic][share]:.1f}" for share in ("p50", "p99")))
        for topic, rate in sorted(summary.rates_hz.items())
        if topic in summary.age_ms
    ]
    return table(("topic", "rate [Hz]", "age p50 [ms]", "age p99 [ms]"), rows)


def _event_table(recording: Recording, start_ns: int) -> str:
    events = sorted(recording.of(Event), key=lambda event: event.time_ns)  # of two senders the later may arrive first
    if not events:
        return "<p>none</p>"
    rows = [(f"{(e.time_ns - start_ns) * 1e-9:.3f} s", e.process, e.code, e.detail) for e in events]
    return table(("time", "process", "event", "detail"), rows, "text")
