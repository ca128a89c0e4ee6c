"""Figures of the report on heightmap errors."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from saltus.arrays import Reals
from saltus.depth import NOTHING
from saltus.heightmap.evaluation.comparison import HeightComparison
from saltus.heightmap.evaluation.errors_by import ErrorRow, GroupedErrors
from saltus.heightmap.evaluation.height_edges import EdgeErrors
from saltus.reports.figures import BLUE, GREEN, GREY, ORANGE, RED, laid_out
from saltus.wire.messages import DepthFrame

# The rest of Okabe and Ito's palette
COLOURS = (
    BLUE,
    ORANGE,
    GREEN,
    RED,
    "#CC79A7",
    "#56B4E9",
    "#F0E442",
)
EDGE_BIN_M = 0.1
MOMENT_HEIGHT = 230  # px
_LEGEND = {"orientation": "h", "y": 1.02, "yanchor": "bottom", "itemsizing": "constant"}
"""Above the curves, which make room for as many lines as it has."""


def distance_figure(errors: Mapping[str, GroupedErrors]) -> go.Figure:
    """Mean and 90 % error over distance ahead, and what the predictors state."""
    figure = go.Figure()
    for (name, of), colour in zip(errors.items(), _colours(errors), strict=True):
        rows = of.by_distance()
        x = [100 * float(row.group) for row in rows]
        for label, values, dash in (
            ("mean", [row.mae_m for row in rows], "solid"),
            ("90 % are below", [row.p90_m for row in rows], "dot"),
            ("half of the stated 90 % interval", [row.half_width_90_m for row in rows], "dash"),
        ):
            figure.add_scatter(
                x=x,
                y=_cm(values),
                name=f"{name}, {label}",
                legendgroup=name,
                line={"color": colour, "dash": dash},
            )
    return _styled(figure, "distance ahead of the base [cm]", height=400)


def group_figure(
    errors: Mapping[str, GroupedErrors],
    rows_of: Callable[[GroupedErrors], list[ErrorRow]],
    title: str,
) -> go.Figure:
    """Mean error of groups as bars, one colour for each predictor."""
    figure = go.Figure()
    for (name, of), colour in zip(errors.items(), _colours(errors), strict=True):
        rows = rows_of(of)
        two_levels = any(row.detail for row in rows)
        groups = [row.group for row in rows]
        figure.add_bar(
            x=[groups, [row.detail for row in rows]] if two_levels else groups,
            y=_cm([row.mae_m for row in rows]),
            name=name,
            marker={"color": colour},
            customdata=[[100 * row.p90_m, 100 * row.bias_m, row.count] for row in rows],
            hovertemplate="%{y:.2f} cm; 90 % below %{customdata[0]:.2f} cm; bias "
            "%{customdata[1]:+.2f} cm; %{customdata[2]} points",
        )
    if not any(row.detail for of in errors.values() for row in rows_of(of)):
        figure.update_xaxes(type="category")
    return _styled(figure, title, height=290)


def edge_figure(edges: Mapping[str, EdgeErrors]) -> go.Figure:
    """Error of the position of jumps over their distance ahead."""
    figure = go.Figure()
    for (name, of), colour in zip(edges.items(), _colours(edges), strict=True):
        index = np.floor(of.true_x / EDGE_BIN_M).astype(np.int64)
        found = np.isfinite(of.error)
        bins = [i for i in np.unique(index) if (found & (index == i)).any()]
        mean = [np.abs(of.error[found & (index == i)]).mean() for i in bins]
        figure.add_scatter(
            x=[100 * EDGE_BIN_M * (i + 0.5) for i in bins], y=_cm(mean), name=name,
            mode="lines+markers",
            line={"color": colour},
        )  # fmt: skip
    return _styled(figure, "true distance of the edge ahead of the base [cm]", height=300)


def calibration_figure(errors: Mapping[str, GroupedErrors]) -> go.Figure:
    """Observed over expected coverage, and the error
    that 90 % are below over half of the stated 90 % interval.
    """
    figure = make_subplots(cols=2, horizontal_spacing=0.12)
    top = 0.0
    for (name, of), colour in zip(errors.items(), _colours(errors), strict=True):
        calibration = of.calibration()
        curves = (
            (calibration.level, calibration.coverage),
            (calibration.stated_m, calibration.observed_m),
        )
        for column, (x, y) in enumerate(curves, start=1):
            figure.add_scatter(
                x=100 * x, y=100 * y, name=name, mode="lines+markers", line={"color": colour},
                legendgroup=name,
                showlegend=column == 1, row=1, col=column,
            )  # fmt: skip
        top = max(top, 100 * float(max(calibration.stated_m.max(), calibration.observed_m.max())))
    for column, end in ((1, 100.0), (2, top)):
        figure.add_scatter(
            x=[0, end], y=[0, end], name="exact", mode="lines", line={"color": GREY, "dash": "dot"},
            legendgroup="exact", showlegend=column == 1, row=1, col=column,
        )  # fmt: skip
    figure.update_xaxes(title="expected coverage [%]", col=1)
    figure.update_yaxes(title="observed [%]", col=1)
    figure.update_xaxes(title="half of the stated 90 % interval [cm]", col=2)
    figure.update_yaxes(title="90 % of errors are below [cm]", col=2)
    return laid_out(figure, 380, margin={"l": 60, "r": 20, "t": 40, "b": 50}, legend=_LEGEND)


def moment_figure(
    index: int,
    moment: HeightComparison,
    others: Sequence[HeightComparison],
    frame: DepthFrame | None,
    names: Sequence[str],
) -> go.Figure:
    """One moment: the image in use, the predictions, and the truth.

    Args:
        index: of the step in `moment`.
        moment: whose prediction is shown with its 90 % interval.
        others: more predictors on the same run.
        frame: None where the recording has not kept it.
        names: of all predictors, in the order of colours.
    """
    figure = make_subplots(cols=2, column_widths=[0.17, 0.83], horizontal_spacing=0.14)
    if frame is not None:
        image, x, y = _image(frame)
        figure.add_heatmap(
            z=image, x=x, y=y, colorscale="Viridis_r", zmin=0.3, zmax=2.0,
            hovertemplate="%{z:.2f} m<extra></extra>",
            colorbar={"title": "m", "thickness": 8, "x": 0.145, "len": 1.0}, row=1, col=1,
        )  # fmt: skip
    figure.update_xaxes(visible=False, col=1)
    figure.update_yaxes(visible=False, autorange="reversed", scaleanchor="x", col=1)
    centimetres = 100 * moment.x
    colours = dict(zip(names, _colours(names), strict=True))
    height, half_width = 100 * moment.height[index], 100 * moment.half_width_90[index]
    band = np.concatenate([height + half_width, (height - half_width)[::-1]])
    figure.add_scatter(
        x=np.concatenate([centimetres, centimetres[::-1]]), y=band,
        fill="toself", line={"width": 0}, fillcolor="rgba(0,114,178,0.15)", name="90 % interval",
        hoverinfo="skip", row=1, col=2,
    )  # fmt: skip
    for comparison in (moment, *others):
        figure.add_scatter(
            x=centimetres, y=100 * comparison.height[index], name=comparison.predictor,
            mode="lines+markers",
            line={"color": colours[comparison.predictor]}, marker={"size": 4}, row=1, col=2,
        )  # fmt: skip
    figure.add_scatter(
        x=centimetres, y=100 * moment.true_height[index], name=moment.reference,
        line={"color": "black", "shape": "hvh"}, row=1, col=2,
    )  # fmt: skip
    figure.update_xaxes(title="ahead of the base [cm]", col=2)
    figure.update_yaxes(title="height [cm]", col=2)
    return laid_out(figure, MOMENT_HEIGHT, margin={"l": 10, "r": 20, "t": 10, "b": 45})


def _image(frame: DepthFrame) -> tuple[Reals, Reals, Reals]:
    """Depth [m] in view of the page: at most 96 rows, NaN where invalid or beyond range.

    And tangents of its pixels.
    """
    every = max(1, frame.depth.shape[0] // 96)
    raw = frame.depth[::every, ::every]
    depth = np.where((raw == 0) | (raw == NOTHING), np.nan, raw * frame.depth_unit_m)
    x = (np.arange(frame.depth.shape[1])[::every] + 0.5 - frame.cx) / frame.fx
    y = (np.arange(frame.depth.shape[0])[::every] + 0.5 - frame.cy) / frame.fy
    return np.round(depth, 3), x, y


def _colours(names: Sequence[str] | Mapping[str, object]) -> list[str]:
    return [COLOURS[i % len(COLOURS)] for i in range(len(names))]


def _cm(values: Sequence[float]) -> list[float]:
    return [100 * float(value) for value in values]


def _styled(figure: go.Figure, title: str, height: int) -> go.Figure:
    figure.update_yaxes(rangemode="tozero")
    return laid_out(figure, height, x=title, y="error [cm]", legend=_LEGEND, barmode="group")
