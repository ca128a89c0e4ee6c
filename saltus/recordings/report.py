"""One HTML file about one recorded run: what happened, in pictures."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote

import numpy as np
import plotly.graph_objects as go

from saltus.arrays import Floats
from saltus.config import RunConfig, to_toml
from saltus.constants import LOADED_N
from saltus.provenance import current_commit
from saltus.recordings.recording import Recording
from saltus.recordings.summary import UNDER_WAY, RunSummary, number_text
from saltus.reports.figures import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    RED,
    contact_figure,
    ground_figure,
    laid_out,
)
from saltus.reports.page import render_page, write_page
from saltus.robots.robot import LEGS
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.terrain.terrain import Terrain
from saltus.wire.messages import (
    Event,
    GroundTruth,
    Heightmap,
    HeightmapStatus,
    MotionPlan,
    RobotState,
    points_of,
)

PROFILE_EVERY = 10  # steps between the profiles that are drawn: more would hide each other
MOST_POINTS = 2000  # of a curve; a page is 1100 pixels wide


@dataclass(frozen=True, kw_only=True)
class RunData:
    """The messages of a run as arrays, joined by step.

    N is the number of steps that have a state and a truth.
    """

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


@dataclass(frozen=True, kw_only=True)
class ScanSection:
    """Heights around the robot in two dimensions, as a report shows them."""

    picture: Path
    rows: list[tuple[str, str, str, str, str]]
    """Group of points, its share, mean error, share inside the 90 % interval, median
    half-width."""

    @classmethod
    def of_figures(cls, figures: Mapping[str, Any], picture: Path) -> Self:
        """The figures that `saltus replay --grid scan` prints."""
        return cls(
            picture=picture,
            rows=[
                (
                    name,
                    f"{100 * group['share']:.0f} %",
                    f"{group['mean_mm']:.1f} mm",
                    f"{100 * group['inside']:.0f} %",
                    f"{group['half_width_mm']:.0f} mm",
                )
                for name, group in figures.items()
                if isinstance(group, Mapping) and "mean_mm" in group
            ],
        )


def join_by_step(recording: Recording) -> RunData:
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


def write_run_report(
    recording: Recording, summary: RunSummary, path: Path, video: Path | None = None,
    scan: ScanSection | None = None,
) -> None:  # fmt: skip
    """Writes the report of a run; it opens without a network.

    It shows the video, which may be yet to be written, and the heights of a scan, if any.
    """
    config = recording.known_config
    data = join_by_step(recording)
    scheduled = np.array([state.leg_contact for state in data.states], dtype=bool).reshape(-1, 4)
    loaded = np.array([truth.foot_force for truth in data.truths]).reshape(-1, 4) > LOADED_N
    text = render_page(
        __file__,
        recording=recording,
        summary=summary,
        headline=_headline(summary, recording.terrain, config),
        shown=number_text,
        beside=lambda file: quote(os.path.relpath(file, path.parent)),
        video=video,
        scan=scan,
        path_figure=_path_figure(data, recording.terrain),
        body_figure=_body_figure(data),
        contact_figure=contact_figure(data.time_s, LEGS, scheduled, loaded),
        error_figure=_error_figure(data),
        powers=[
            (
                each.motion,
                f"{each.seconds:.2f} s",
                f"{each.peak_w:.0f} W",
                f"{each.driving_w:.0f} W",
                f"{each.joint}, {each.joint_w:.0f} W",
                f"{100.0 * each.voltage_left:.0f} %",
            )
            for each in summary.motions
        ],
        ages=[
            (
                topic,
                f"{rate:.1f}",
                *(f"{summary.age_ms[topic][share]:.1f}" for share in ("p50", "p99")),
            )
            for topic, rate in sorted(summary.rates_hz.items())
            if topic in summary.age_ms
        ],
        events=[
            (
                f"{(event.time_ns - data.start_ns) * 1e-9:.3f} s",
                event.process,
                event.code,
                event.detail,
            )
            # of two senders the later may arrive first
            for event in sorted(recording.of(Event), key=lambda event: event.time_ns)
        ],
        commit=current_commit(),
        config=to_toml(config),
    )
    write_page(path, text)


def _headline(summary: RunSummary, terrain: Terrain, config: RunConfig) -> str:
    where = course_title(terrain)
    speed = f" at {config.speed:g} of real time" if config.speed < 1.0 else ""
    run = f"seed {config.seed}, {config.pace}{speed}"
    if summary.success:
        return (
            f"Crossed {where} in {summary.time_s:.2f} s at {summary.mean_speed_mps:.2f} m/s; {run}"
        )
    way = number_text(summary.distance_m, 2, "m")
    return f"Did not cross {where}: {summary.explanation}; {way}, {run}"


def course_title(terrain: Terrain) -> str:
    """A terrain in words: its kind and its sizes."""
    sizes = ", ".join(_size(name, value) for name, value in terrain.params.items())
    return f"{terrain.kind.replace('_', ' ')} ({sizes})" if sizes else terrain.kind


def _size(name: str, value: float) -> str:
    if isinstance(value, int):
        return f"{value} {name}"
    size, _, unit = name.rpartition("_")
    return (
        f"{size.replace('_', ' ')} {value:g} {unit}"
        if unit in ("m", "deg") and size
        else f"{name} {value:g}"
    )


def _path_figure(data: RunData, terrain: Terrain) -> go.Figure:
    x_end = float(data.position[:, 0].max()) + 1.0 if len(data.position) else 1.0
    figure = ground_figure(terrain, -0.6, x_end)
    for status, colour in (
        (HeightmapStatus.OK, GREEN),
        (HeightmapStatus.WARMING, ORANGE),
        (HeightmapStatus.DEGRADED, RED),
    ):
        x, z = _predicted_points(data, status)
        if len(x):
            name = f"predicted heights ({status.name.lower()})"
            marker = {"color": colour, "size": 3, "opacity": 0.5}
            figure.add_scattergl(x=x, y=z, mode="markers", name=name, marker=marker)
    way = data.position[:: _stride(len(data.position))]
    figure.add_scatter(x=way[:, 0], y=way[:, 2], name="base", line={"color": BLUE, "width": 2})
    return laid_out(figure, 430, x="x [m]", y="z [m]", legend_y=1.12)


def _predicted_points(data: RunData, status: HeightmapStatus) -> tuple[Floats, Floats]:
    """World x and z of the predicted points of every tenth step."""
    points = [np.zeros((2, 0))]
    for truth in data.truths[:: PROFILE_EVERY * _stride(len(data.truths))]:
        heightmap = data.heightmaps.get(truth.step)
        if heightmap is not None and heightmap.status == status:
            x, _, z = truth.position_base_in_world
            _, _, yaw = roll_pitch_yaw(rotation_matrix(truth.quaternion_base_in_world))
            along = points_of(heightmap) @ [np.cos(yaw), -np.sin(yaw)]
            points.append(np.stack([x + along, z + heightmap.height]))
    x, z = np.concatenate(points, axis=1)
    return x, z


def _stride(count: int) -> int:
    """Which of so many points of a curve are drawn: all, or every second one, and so on."""
    return max(1, -(-count // MOST_POINTS))


def _body_figure(data: RunData) -> go.Figure:
    _, pitch, _ = roll_pitch_yaw(rotation_matrix(data.quaternion))
    speed = np.array([truth.velocity_base_in_world[0] for truth in data.truths])
    estimate = np.array([state.velocity_base_in_world[0] for state in data.states])
    figure = go.Figure()
    some = slice(None, None, _stride(len(data.time_s)))
    for name, values, axis, line in (
        ("height z [m]", data.position[:, 2], "y", {"color": BLUE}),
        ("pitch [deg], nose down positive", np.degrees(pitch), "y2", {"color": ORANGE}),
        ("forward speed [m/s]", speed, "y3", {"color": GREEN}),
        ("its estimate [m/s]", estimate, "y3", {"color": GREEN, "dash": "dot"}),
    ):
        figure.add_scatter(x=data.time_s[some], y=values[some], name=name, yaxis=axis, line=line)
    return laid_out(
        figure, 520, legend_y=1.08, xaxis={"title": "time [s]", "anchor": "y3"},
        yaxis={"domain": [0.70, 1.0], "title": "z [m]"},
        yaxis2={"domain": [0.36, 0.64], "title": "pitch [deg]"},
        yaxis3={"domain": [0.0, 0.30], "title": "speed [m/s]"},
    )  # fmt: skip


def _error_figure(data: RunData) -> go.Figure:
    """Errors of the steps that the headline counts:
    it runs or walks, on a heightmap of status OK.
    """
    running = [t for t, s in zip(data.truths, data.states, strict=True) if s.mode in UNDER_WAY]
    pairs = [(data.heightmaps[t.step], t) for t in running if t.step in data.heightmaps]
    trusted = [
        (h, t)
        for h, t in pairs
        if h.status == HeightmapStatus.OK and len(h.height) == len(t.height)
    ]
    figure = go.Figure()
    if trusted:
        x, steps_and_columns = 100 * np.asarray(trusted[0][0].x), (0, 2)
        shape = (len(trusted), len(x), -1)
        error = 100 * np.abs(
            np.array([np.asarray(h.height) - t.height for h, t in trusted])
        ).reshape(shape)
        claimed = 100 * np.array([np.asarray(h.half_width_90) for h, _ in trusted]).reshape(shape)
        for name, values, colour in (
            ("median error", np.median(error, axis=steps_and_columns), BLUE),
            ("90 % of errors are below", np.quantile(error, 0.9, axis=steps_and_columns), RED),
            (
                "half of the 90 % interval that the model states, median",
                np.median(claimed, axis=steps_and_columns),
                GREY,
            ),
        ):
            figure.add_scatter(
                x=x, y=values, name=name, mode="lines+markers", line={"color": colour}
            )
    figure.update_yaxes(rangemode="tozero")
    return laid_out(figure, 330, x="distance ahead of the base [cm]", y="[cm]", legend_y=1.15)
