"""The ground ahead of a robot that stands, as its camera's claimed place has it
and as the found one does.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from saltus.render.calibrate import CameraCalibration
from saltus.reports.figures import laid_out
from saltus.reports.page import render_page, write_page

SHOWN = 4000  # points: more would hide each other
CLAIMED, FOUND = "#d1495b", "#1f5fa8"


@dataclass(frozen=True, kw_only=True)
class PlaceRow:
    """A number of a camera's calibrated place, in units for people."""

    name: str
    unit: str
    claimed: float
    found: float
    half_width_90: float


def place_rows(found: CameraCalibration) -> list[PlaceRow]:
    """Pitch and roll [deg], height [mm]."""
    units, scales = (
        {"pitch": "deg", "roll": "deg", "height": "mm"},
        {"deg": 180.0 / np.pi, "mm": 1e3},
    )
    return [
        PlaceRow(
            name=name,
            unit=unit,
            claimed=scales[unit] * getattr(found.claimed, name),
            found=scales[unit] * getattr(found.found, name),
            half_width_90=scales[unit] * getattr(found.half_width_90, name),
        )
        for name, unit in units.items()
    ]


def write_calibration_plot(found: CameraCalibration, path: Path) -> Path:
    """Writes one HTML file."""
    figure = go.Figure()
    every = max(1, len(found.points_found) // SHOWN)
    for name, points, colour in (
        ("claimed", found.points_claimed, CLAIMED),
        ("found", found.points_found, FOUND),
    ):
        figure.add_scattergl(
            x=points[::every, 0], y=100.0 * points[::every, 1], mode="markers", name=f"as {name}",
            marker={"color": colour, "size": 3},
        )  # fmt: skip
    figure.add_hline(y=0.0, line={"color": "#444", "width": 1})
    figure.update_yaxes(range=[-30, 30])
    margin = {"l": 60, "r": 20, "t": 30, "b": 50}
    x, y = "ahead of the trunk's centre [m]", "over the ground [cm]"
    laid_out(figure, 460, x=x, y=y, width=1000, margin=margin)
    write_page(path, render_page(__file__, found=found, points=figure, rows=place_rows(found)))
    return path
