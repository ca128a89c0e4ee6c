"""Figures of the report on what a simulator lacks."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from saltus.arrays import Floats
from saltus.real2sim.problem.problem import ExplanatoryVariable
from saltus.real2sim.reporting.localise import TIME, ResidualSignal
from saltus.real2sim.search.findings import EffectConfusion, RankedModel, SignalGap
from saltus.reports.figures import BLUE, GREEN, GREY, RED

BEFORE, AFTER, FLOOR = RED, BLUE, GREEN
WIDE, THIN = 3.5, 1.5  # px: where two lines agree, both can be seen
TITLE_PX, ROW_PX = 45, 34  # px: space between parts of a figure, height of a row of a table
LEAST_NATS = 1.0  # gain of a model below which it is chance
BINS = 15
FEW = 50  # rows of a channel below which bins are chance
TRACE_S = 2.0  # shown of a residual: about ten periods of a joint's oscillation
BREAK = 5.0  # median time steps: a longer step breaks the line


def gap_figure(gaps: Sequence[SignalGap]) -> go.Figure:
    """RMS of each signal before and after, and the floor, on a logarithmic axis."""
    # A logarithmic axis has no 0
    gaps = [gap for gap in gaps if gap.before > 0.0 or gap.after > 0.0]
    names = [gap.signal for gap in gaps]
    figure = go.Figure()
    for gap in gaps:
        figure.add_scatter(
            x=np.sqrt([gap.before, gap.after]), y=[gap.signal] * 2, mode="lines", showlegend=False,
            hoverinfo="skip",
            line={"color": "#bbbbbb", "width": 3},
        )  # fmt: skip
    for name, colour, symbol, values in (
        ("floor: noise alone", FLOOR, "line-ns", [gap.floor for gap in gaps]),
        ("before", BEFORE, "circle", [gap.before for gap in gaps]),
        ("after", AFTER, "circle", [gap.after for gap in gaps]),
    ):
        figure.add_scatter(
            x=np.sqrt(np.maximum(values, 0.0)), y=names, name=name, mode="markers",
            marker={"color": colour, "size": 11, "symbol": symbol,
                "line": {"width": 2, "color": colour}},
            hovertemplate="%{y}: %{x:.2f} sigma",
        )  # fmt: skip
    figure.update_xaxes(title="RMS [sigma]", type="log")
    figure.update_yaxes(autorange="reversed", type="category")
    return _sized(figure, 110 + 22 * len(names))


def matrix_figure(before: Sequence[ResidualSignal], after: Sequence[ResidualSignal]) -> go.Figure:
    """RMS of every signal at every place, before and after, in one colour scale."""
    signals = list(dict.fromkeys(channel.signal for channel in before))
    places = list(dict.fromkeys(channel.place for channel in before))
    figure = make_subplots(
        rows=2,
        cols=1,
        subplot_titles=("before", "after"),
        shared_xaxes=True,
        vertical_spacing=TITLE_PX / (TITLE_PX + 2 * ROW_PX * len(signals)),
    )
    tables = [_rms_table(channels, signals, places) for channels in (before, after)]
    top = float(np.nanmax([np.nanmax(table) for table in tables]))
    for row, table in enumerate(tables, start=1):
        figure.add_heatmap(
            z=np.log10(np.maximum(table, 0.1)), x=places, y=signals, text=np.round(table, 1),
            texttemplate="%{text}",
            colorscale="YlOrRd", zmin=np.log10(0.7), zmax=np.log10(max(top, 3.0)), showscale=False,
            hovertemplate="%{y} of %{x}: %{text} sigma<extra></extra>", row=row, col=1,
        )  # fmt: skip
    figure.update_yaxes(autorange="reversed")
    return _sized(figure, 85 + TITLE_PX + 2 * ROW_PX * len(signals))


def worst_channels(channels: Sequence[ResidualSignal], count: int = 3) -> list[int]:
    """Indices of the channels with the largest RMS, one of each signal and kind of place."""
    kinds: dict[tuple[str, str], int] = {}
    order = sorted(range(len(channels)), key=lambda i: -_rms(channels[i].residual))
    for i in order:
        if len(channels[i].residual) >= FEW:
            kinds.setdefault((channels[i].signal, channels[i].place.rpartition("_")[2]), i)
    return list(kinds.values())[:count]


def residual_figure(before: ResidualSignal, after: ResidualSignal) -> go.Figure:
    """RMS of the residual of a signal over each explanatory variable, in bins of equal count."""
    variables = [
        variable for variable in before.variables if variable.unit and np.ptp(variable.values) > 0.0
    ]
    columns = len(variables) if len(variables) <= 5 else 4
    rows = -(-len(variables) // columns)
    figure = make_subplots(rows=rows, cols=columns, shared_yaxes="all", horizontal_spacing=0.03)
    for i, variable in enumerate(variables):
        row, column = 1 + i // columns, 1 + i % columns
        for name, colour, width, channel in (
            ("before", BEFORE, WIDE, before),
            ("after", AFTER, THIN, after),
        ):
            x, y = rms_by(variable, channel.residual)
            figure.add_scatter(
                x=x, y=y, name=name, legendgroup=name, showlegend=i == 0, mode="lines+markers",
                line={"color": colour, "width": width}, marker={"size": 2 + width}, row=row,
                col=column,
            )  # fmt: skip
        figure.update_xaxes(
            title=f"{variable.name} [{variable.unit}]", title_standoff=4, row=row, col=column
        )
    figure.add_hline(y=1.0, line={"color": GREY, "dash": "dot", "width": 1})
    figure.update_yaxes(rangemode="tozero")
    figure.update_yaxes(title=f"{before.signal}, {before.place} [sigma]", col=1)
    return _sized(figure, 60 + 200 * rows)


def rms_by(variable: ExplanatoryVariable, residual: Floats) -> tuple[Floats, Floats]:
    """Mean of the variable and RMS of the residual,
    in bins of equal count or at each of few values.
    """
    values, where = np.unique(variable.values, return_inverse=True)
    if len(values) > BINS:
        edges = np.unique(np.quantile(variable.values, np.linspace(0.0, 1.0, BINS + 1)))
        where = np.searchsorted(edges[1:-1], variable.values, side="right")
    counts = np.bincount(where)
    used = counts > 0
    x = np.bincount(where, variable.values)[used] / counts[used]
    return x, np.sqrt(np.bincount(where, residual**2)[used] / counts[used])


def trace_figure(before: ResidualSignal, after: ResidualSignal) -> go.Figure:
    """Residuals over the two seconds in which they are largest.

    If there are many pixels, their mean.
    """
    time_s = next(variable.values for variable in before.variables if variable.name == TIME)
    times, owner = np.unique(time_s, return_inverse=True)
    counts = np.bincount(owner)
    series = [np.bincount(owner, channel.residual) / counts for channel in (before, after)]
    ends = np.searchsorted(times, times + TRACE_S)
    power = np.concatenate([[0.0], np.cumsum(series[0] ** 2)])
    start = int(np.argmax(power[ends] - power[: len(times)]))
    shown = slice(start, int(ends[start]))
    steps = np.diff(times[shown], append=np.nan)
    is_break = (
        steps > BREAK * np.nanmedian(steps) if len(steps) > 1 else np.zeros(len(steps), dtype=bool)
    )
    figure = go.Figure()
    for name, colour, width, values in (
        ("before", BEFORE, WIDE, series[0]),
        ("after", AFTER, THIN, series[1]),
    ):
        line = np.where(is_break, np.nan, values[shown])
        style = {"color": colour, "width": width}
        figure.add_scatter(x=np.round(times[shown], 4), y=np.round(line, 3), name=name, line=style)
    figure.update_xaxes(title=f"{TIME} [s]")
    figure.update_yaxes(title=f"{before.signal}, {before.place} [sigma]")
    return _sized(figure, 240)


def image_figure(
    before: ResidualSignal,
    after: ResidualSignal,
    row: ExplanatoryVariable,
    column: ExplanatoryVariable,
) -> go.Figure:
    """Mean residual of each pixel of the grid, before and after."""
    rows, y = np.unique(row.values, return_inverse=True)
    columns, x = np.unique(column.values, return_inverse=True)
    shape = (len(rows), len(columns))
    pixel = y * len(columns) + x
    counts = np.bincount(pixel, minlength=shape[0] * shape[1]).astype(np.float64)
    counts[counts == 0.0] = np.nan
    images = [np.bincount(pixel, c.residual, len(counts)) / counts for c in (before, after)]
    size = max(1.0, float(np.nanmax(np.abs(images))))
    figure = make_subplots(cols=2, subplot_titles=("before", "after"), horizontal_spacing=0.08)
    for index, image in enumerate(images, start=1):
        figure.add_heatmap(
            z=np.round(image.reshape(shape), 2), x=columns, y=rows, zmin=-size, zmax=size,
            colorscale="RdBu",
            colorbar={"title": "sigma", "thickness": 10}, showscale=index == 2,
            hovertemplate="column %{x:.0f}, row %{y:.0f}: %{z:.2f} sigma<extra></extra>", row=1,
            col=index,
        )  # fmt: skip
    figure.update_xaxes(title="column [px]")
    figure.update_yaxes(title="row [px]", autorange="reversed")
    return _sized(figure, 330)


def ranked(ranking: Sequence[RankedModel]) -> list[RankedModel]:
    """The models with a gain on held-out data."""
    return [model for model in ranking if model.effects and model.gain >= LEAST_NATS]


def idle(ranking: Sequence[RankedModel]) -> list[RankedModel]:
    """The models without."""
    return [model for model in ranking if model.effects and model.gain < LEAST_NATS]


def ranking_figure(ranking: Sequence[RankedModel], chosen: tuple[str, ...]) -> go.Figure:
    """Held-out gain of every model that gains anything, best first; the chosen model in green."""
    models = ranked(ranking)
    gains = np.array([model.gain for model in models])
    low, high = np.array([model.gain_ci90 for model in models]).T
    figure = go.Figure()
    figure.add_scatter(
        x=gains, y=[" + ".join(model.effects) for model in models], mode="markers+text",
        showlegend=False,
        marker={"color": [GREEN if model.effects == chosen else BLUE for model in models],
            "size": 10},
        error_x={
            "type": "data", "symmetric": False, "array": np.maximum(0.0, high - gains),
            "arrayminus": gains - np.clip(low, LEAST_NATS, gains), "color": GREY, "thickness": 1.5,
        },
        text=[f" {max(0.0, model.closed):.0%} closed" for model in models],
        textposition="top right",
        cliponaxis=False, customdata=np.stack([gains, low, high], axis=1),
        hovertemplate="%{y}: %{customdata[0]:.0f} nats (%{customdata[1]:.0f} to "
                      "%{customdata[2]:.0f})<extra></extra>",
    )  # fmt: skip
    left = float(np.log10(np.maximum(LEAST_NATS, low).min())) - 0.1
    right = float(np.log10(np.maximum(high, gains).max())) + 0.1
    figure.update_xaxes(
        title="held-out gain [nats], with 90 % intervals",
        type="log",
        range=[left, max(right, left + 1.0)],
    )
    figure.update_yaxes(autorange="reversed", type="category", automargin=True)
    # Labels of the rightmost marks
    return _sized(figure, 90 + 34 * len(models)).update_layout(margin_r=100)


def confusion_figure(confusion: EffectConfusion) -> go.Figure:
    """Cosines between the signatures of effects; the upper half would repeat the lower."""
    count = len(confusion.effects)
    lower = np.where(np.tri(count, k=-1, dtype=bool), confusion.cosine, np.nan)[1:, :-1]
    figure = go.Figure()
    figure.add_heatmap(
        z=lower, x=confusion.effects[:-1], y=confusion.effects[1:], zmin=0.0, zmax=1.0,
        colorscale="Blues",
        text=[["" if np.isnan(c) else f"{c:.2f}".lstrip("0") for c in row] for row in lower],
        texttemplate="%{text}",
        hovertemplate="%{y} and %{x}: %{z:.3f}<extra></extra>",
        colorbar={"title": "|cos|", "thickness": 10},
        hoverongaps=False,
    )  # fmt: skip
    figure.update_xaxes(tickangle=-45, automargin=True)
    figure.update_yaxes(autorange="reversed", automargin=True)
    return _sized(figure, 190 + 27 * count)


def _rms_table(channels: Sequence[ResidualSignal], signals: list[str], places: list[str]) -> Floats:
    table = np.full((len(signals), len(places)), np.nan)
    for channel in channels:
        table[signals.index(channel.signal), places.index(channel.place)] = _rms(channel.residual)
    return table


def _rms(residual: Floats) -> float:
    return float(np.sqrt(np.mean(residual**2)))


def _sized(figure: go.Figure, height: int) -> go.Figure:
    figure.update_layout(
        height=height,
        margin={"l": 60, "r": 20, "t": 40, "b": 45},
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0},
    )
    return figure
