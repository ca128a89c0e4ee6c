"""Figures of a cycle's report."""

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from saltus.policy.evaluation.evaluate import success_interval
from saltus.real2sim.cycle.measuring import MOMENTS, Measured, When
from saltus.real2sim.cycle.truth import TruthRow
from saltus.reports.figures import BLUE, GREEN, GREY, RED, laid_out

COLOURS: dict[When, str] = {"before": RED, "after": BLUE}


def success_figure(courses: Mapping[str, Mapping[When, Measured]]) -> go.Figure:
    """Share of trials that succeeded on each course before and after, with 95 % intervals."""
    figure = go.Figure()
    for when in MOMENTS:
        done = {course: measured[when] for course, measured in courses.items() if when in measured}
        counts = [(trials.successes, len(trials.failures)) for trials in done.values()]
        share = np.array([100 * hits / count for hits, count in counts])
        low, high = 100 * np.array([success_interval(*count) for count in counts]).reshape(-1, 2).T
        figure.add_bar(
            x=list(done), y=share, name=f"{when}", marker_color=COLOURS[when],
            text=[f"{hits} of {count}" for hits, count in counts], textposition="inside", insidetextanchor="start",
            error_y={"type": "data", "symmetric": False, "array": high - share, "arrayminus": share - low},
        )  # fmt: skip
    figure.update_yaxes(range=[0, 104])
    return laid_out(figure, 380, y="trials that succeeded [%]", legend_y=1.12, barmode="group")


def truth_figure(rows: Sequence[TruthRow]) -> go.Figure:
    """Draws what was found of each hidden change, as a share of it: 0 is what was known, 100 % is the truth."""
    figure = go.Figure()
    shares = [_shares(row) for row in rows]
    names = [row.name for row in rows]
    found = [(name, share) for name, share in zip(names, shares, strict=True) if share is not None]
    figure.add_scatter(
        x=[middle for _, (_, middle, _) in found], y=[name for name, _ in found], mode="markers", name="found",
        marker={"color": BLUE, "size": 11},
        error_x={
            "type": "data", "symmetric": False, "array": [high - middle for _, (_, middle, high) in found],
            "arrayminus": [middle - low for _, (low, middle, _) in found],
        },
    )  # fmt: skip
    missed = [name for name, share in zip(names, shares, strict=True) if share is None]
    figure.add_scatter(
        x=[0.0] * len(missed), y=missed, mode="markers", name="not found",
        marker={"color": RED, "size": 11, "symbol": "x"},
    )  # fmt: skip
    figure.add_vline(x=100.0, line={"color": GREEN, "width": 2})
    figure.add_vline(x=0.0, line={"color": GREY, "dash": "dot", "width": 1})
    figure.update_yaxes(autorange="reversed", type="category", categoryorder="array", categoryarray=names)
    return laid_out(
        figure, 130 + 34 * len(rows), x="of the hidden change [%], with 90 % intervals; green: the truth",
        margin={"l": 260, "r": 20, "t": 40, "b": 50}, legend={"orientation": "h", "y": 1.0, "yanchor": "bottom"},
    )  # fmt: skip


def _shares(row: TruthRow) -> tuple[float, float, float] | None:
    """Lower end, value and upper end of what was found, in % of the change; None where nothing was found."""
    if row.found is None or row.ci90 is None or row.true is None or row.known is None:
        return None
    change = 0.01 * (row.true - row.known)
    low, middle, high = ((value - row.known) / change for value in (row.ci90[0], row.found, row.ci90[1]))
    return min(low, high), middle, max(low, high)
