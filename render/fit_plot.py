"""Measured against model: what a recording shows of a stereo camera,
and what the fitted model says of it.
"""

import math
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from saltus.arrays import Floats, Reals
from saltus.render.stereo.fit_baseline import edge_shadows, left_bands
from saltus.render.stereo_fit import FitResult
from saltus.reports.page import render_page, write_page

PlotCurve = tuple[Floats, Floats]
"""Points, each of shape (n,)."""
MEASURED = {"mode": "markers", "marker": {"color": "#1f5fa8", "size": 6}}
SHOWN = 400  # widths: more would hide each other
MODEL = {"mode": "lines", "line": {"color": "#d1495b", "width": 2}}
TITLES = (
    "Noise against range",
    "Width of shadows and left band",
    "Invalid by image column",
    "Invalid beside right edges of near things",
    "Correlation of the noise in the image",
    "Correlation of the noise in time",
)


def write_fit_plot(result: FitResult, path: Path) -> Path:
    """Writes one page with all plots; what is untestable says so."""
    figure = make_subplots(
        rows=3, cols=2, subplot_titles=TITLES, vertical_spacing=0.11, horizontal_spacing=0.1
    )
    _noise(figure, result)
    _widths(figure, result)
    _columns(figure, result)
    _edges(figure, result)
    figure.update_layout(
        height=1080, width=1100, showlegend=False, margin={"l": 60, "r": 20, "t": 100, "b": 50}
    )
    figure.update_layout(
        title=f"{result.scene.frames} frames at rest: measured (dots) and fitted model (lines)"
    )
    write_page(path, render_page(__file__, plots=figure, found=vars(result.parameters)))
    return path


def _add(
    figure: go.Figure,
    row: int,
    column: int,
    measured: tuple[Reals, Reals],
    model: tuple[Floats, Floats],
) -> None:
    figure.add_trace(go.Scatter(x=measured[0], y=measured[1], **MEASURED), row=row, col=column)
    figure.add_trace(go.Scatter(x=model[0], y=model[1], **MODEL), row=row, col=column)


def _axes(figure: go.Figure, row: int, column: int, x: str, y: str) -> None:
    figure.update_xaxes(title_text=x, row=row, col=column)
    figure.update_yaxes(title_text=y, row=row, col=column)


def _noise(figure: go.Figure, result: FitResult) -> None:
    noise, config = result.noise, result.config
    _axes(figure, 1, 1, "depth [m]", "standard deviation [mm]")
    _axes(figure, 3, 1, "lag [px]", "correlation")
    _axes(figure, 3, 2, "lag [ms]", "correlation")
    if noise is None:
        for row, column in ((1, 1), (3, 1), (3, 2)):
            figure.add_annotation(
                text="too few frames", showarrow=False, x=1.0, y=1.0, row=row, col=column
            )
        return
    depth = np.geomspace(noise.range_m.min() / 1.2, noise.range_m.max() * 1.2, 80)
    sigma = float(np.max(config.disparity_noise.sigma))
    disparity_variance = sigma**2 + config.disparity_step.step**2 / 12.0
    spread = np.sqrt(
        disparity_variance * (depth**2 / result.optics.disparity_at_1m) ** 2
        + result.scene.unit_m**2 / 12.0
    )
    _add(figure, 1, 1, (noise.range_m, 1e3 * noise.sigma_m), (depth, 1e3 * spread))
    figure.update_xaxes(type="log", row=1, col=1)
    figure.update_yaxes(type="log", row=1, col=1)
    share = sigma**2 / disparity_variance
    lag = np.linspace(0.0, noise.lag_px[-1], 100)
    window = config.disparity_noise.correlation / (1.0 - math.exp(-1.0))
    triangle = share * np.clip(1.0 - lag / window, 0.0, 1.0)
    _add(figure, 3, 1, (noise.lag_px[1:], noise.correlation_in_image[1:]), (lag, triangle))
    time = np.linspace(0.0, noise.lag_s[-1], 100)
    decay = share * np.exp(-time / config.disparity_noise.persistence_s)
    _add(figure, 3, 2, (1e3 * noise.lag_s[1:], noise.correlation_in_time[1:]), (1e3 * time, decay))


def _widths(figure: go.Figure, result: FitResult) -> None:
    """Both over the difference of inverse depth: the slope is focal length times baseline."""
    _axes(figure, 1, 2, "difference of inverse depth [1/m]", "width [px]")
    margin = result.parameters.margin_px.value or 0.0
    steps = []
    for shadows, offset in ((edge_shadows(result.scene), 0.0), (left_bands(result.scene), margin)):
        some = shadows[:: max(1, len(shadows.width) // SHOWN)]
        if some.width.size:
            line = np.array([0.0, float(some.step.max())])
            model = line * result.optics.disparity_at_1m - offset
            _add(figure, 1, 2, (some.step, some.width), (line, model))
            steps.append(some.step)
    if not steps:
        figure.add_annotation(
            text="no band, no shadow in view", showarrow=False, x=0.5, y=0.5, row=1, col=2
        )


def _columns(figure: go.Figure, result: FitResult) -> None:
    _axes(figure, 2, 1, "column [px]", "invalid share")
    column = np.arange(float(result.scene.median.shape[1]))
    margin = result.parameters.margin_px.value or 0.0
    covered = np.zeros((2, len(column)))
    for k, shadows in enumerate((left_bands(result.scene), edge_shadows(result.scene))):
        width = shadows.step * result.optics.disparity_at_1m - (margin if k == 0 else 0.0)
        begin, end = (np.zeros_like(width), width) if k == 0 else (shadows.end - width, shadows.end)
        centre = column + 0.5
        covered[k] = np.sum((centre > begin[:, None]) & (centre < end[:, None]), axis=0)
    model = np.sum(covered, axis=0) / result.scene.median.shape[0]
    _add(figure, 2, 1, (column, result.edges.column), (column, model))


def _edges(figure: go.Figure, result: FitResult) -> None:
    _axes(figure, 2, 2, "distance from the edge [px], far side positive", "invalid share")
    edges, holes = result.edges, result.config.edge_holes
    inside = (edges.distance_px > 0) & (edges.distance_px <= math.ceil(holes.reach))
    excess = math.ceil(holes.reach) / holes.reach
    model = np.where(inside, float(np.max(holes.fraction)) / excess, 0.0)
    if edges.edges:
        _add(
            figure,
            2,
            2,
            (edges.distance_px, edges.invalid),
            (edges.distance_px.astype(float), model),
        )
    else:
        figure.add_annotation(
            text="no clean right edge in view", showarrow=False, x=0.5, y=0.5, row=2, col=2
        )
