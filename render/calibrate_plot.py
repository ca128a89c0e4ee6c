"""The ground ahead of a robot that stands, as its camera's claimed place has it and as the found one does."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from saltus.recordings.page import figure_html, page, table, write_page
from saltus.render.calibrate import Calibration

SHOWN = 4000  # points: more would hide each other
CLAIMED, FOUND = "#d1495b", "#1f5fa8"
NOTE = (
    "Each point is a pixel: how far ahead of the trunk, and how high over the ground on which the feet stand. With the "
    "right place they lie on the line; stereo matching spreads them more the farther they are."
)


@dataclass(frozen=True, kw_only=True)
class Row:
    """A number of the camera's place, in units for people."""

    name: str
    unit: str
    claimed: float
    found: float
    half_width_90: float


def rows_of(found: Calibration) -> list[Row]:
    """Pitch and roll [deg], height [mm]."""
    units, scales = {"pitch": "deg", "roll": "deg", "height": "mm"}, {"deg": 180.0 / np.pi, "mm": 1e3}
    return [
        Row(
            name=name,
            unit=unit,
            claimed=scales[unit] * getattr(found.claimed, name),
            found=scales[unit] * getattr(found.found, name),
            half_width_90=scales[unit] * getattr(found.half_width_90, name),
        )
        for name, unit in units.items()
    ]


def write_calibration_plot(found: Calibration, path: Path) -> Path:
    """Writes one HTML file."""
    figure = go.Figure()
    every = max(1, len(found.points_found) // SHOWN)
    for name, points, colour in (("claimed", found.points_claimed, CLAIMED), ("found", found.points_found, FOUND)):
        figure.add_scattergl(
            x=points[::every, 0], y=100.0 * points[::every, 1], mode="markers", name=f"as {name}",
            marker={"color": colour, "size": 3},
        )  # fmt: skip
    figure.add_hline(y=0.0, line={"color": "#444", "width": 1})
    figure.update_xaxes(title="ahead of the trunk's centre [m]")
    figure.update_yaxes(title="over the ground [cm]", range=[-30, 30])
    figure.update_layout(height=460, width=1000, margin={"l": 60, "r": 20, "t": 30, "b": 50})
    head = ("", "unit", "claimed", "found", "+- (90 %)")
    cells = (
        (row.name, row.unit, f"{row.claimed:.3f}", f"{row.found:.3f}", f"{row.half_width_90:.3f}")
        for row in rows_of(found)
    )
    shares = f"{100 * found.on_ground:.0f} % of the points of {found.frames} images lie on the ground."
    body = f"<h1>Where the camera sits</h1><p>{shares} {NOTE}</p>{figure_html(figure)}{table(head, cells)}"
    write_page(path, page("Where the camera sits", body))
    return path
