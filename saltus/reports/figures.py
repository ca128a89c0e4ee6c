"""Parts that figures of several reports share:
colours, axes, the ground, and lines where feet stand.
"""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from saltus.terrain.terrain import Terrain

# Okabe and Ito's palette: told apart by colour-blind readers
BLUE, ORANGE, GREEN, RED, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#555555"
Times = NDArray[np.floating]
Mask = NDArray[np.bool_]


def laid_out(
    figure: go.Figure,
    height: int,
    *,
    x: str = "",
    y: str = "",
    legend_y: float | None = None,
    **layout: object,
) -> go.Figure:
    """The figure itself, with its height [px], titles of its axes,
    and a flat legend from `legend_y` up.
    """
    if x:
        figure.update_xaxes(title=x)
    if y:
        figure.update_yaxes(title=y)
    if legend_y is not None:
        figure.update_layout(legend={"orientation": "h", "y": legend_y})
    return figure.update_layout(height=height, **layout)


def ground_figure(terrain: Terrain, start_x: float, end_x: float) -> go.Figure:
    """The terrain from the side, along y = 0, with its walls upright, in one scale of both axes."""
    x = np.unique(
        np.concatenate([np.linspace(start_x, end_x, 2000), terrain.edges_x - 1e-6, terrain.edges_x])
    )
    x = x[(x >= start_x) & (x <= end_x)]
    figure = go.Figure()
    figure.add_scatter(
        x=x, y=terrain.height_at(x, 0.0), name="terrain", line={"color": GREY, "width": 1.5}
    )
    return figure.update_yaxes(scaleanchor="x", scaleratio=1)


def contact_figure(time_s: Times, legs: Sequence[str], scheduled: Mask, loaded: Mask) -> go.Figure:
    """Lines where legs, or pairs of them, are scheduled to stand, and below where they bear load.

    Shape (n, legs).
    """
    figure = go.Figure()
    for index, leg in enumerate(legs):
        level = float(len(legs) - index)
        for mask, colour, shift, name in (
            (scheduled, BLUE, 0.12, "scheduled"),
            (loaded, ORANGE, -0.12, "measured"),
        ):
            kept = _around_changes(mask[:, index])
            line = np.where(mask[kept, index], level + shift, np.nan)
            figure.add_scatter(
                x=time_s[kept], y=line, mode="lines", name=name, showlegend=index == 0,
                connectgaps=False,
                line={"color": colour, "width": 7}, hoverinfo="skip", text=leg,
            )  # fmt: skip
    levels = list(range(len(legs), 0, -1))
    figure.update_yaxes(tickvals=levels, ticktext=list(legs), range=[0.5, len(legs) + 0.5])
    return laid_out(figure, 100 + 40 * len(legs), x="time [s]", legend_y=1.2)


def _around_changes(mask: Mask) -> NDArray[np.intp]:
    """The samples that a line needs which is drawn where a mask,
    shape (n,), holds: first, last, and at each change.
    """
    changes = np.flatnonzero(mask[1:] != mask[:-1])
    return (
        np.unique(np.concatenate([[0], changes, changes + 1, [len(mask) - 1]]))
        if len(mask)
        else changes
    )
