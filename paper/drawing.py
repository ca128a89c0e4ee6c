"""Figures of rows as PNG; needs matplotlib. One drawing serves the file and the page."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from saltus.extras import check_package
from saltus.terrain.terrain import Terrain

DPI = 110
"""Dots an inch of figures 9 inches wide: what fits a page, at a third of the size of twice as
many."""
COLOURS = 256
"""Colours of a palette: a third of the bytes, for a difference that nobody sees."""
WIDTH_IN = 9.0
GROUND = "0.72"
FRONT, REAR, OURS, OTHER = "tab:blue", "tab:orange", "tab:blue", "tab:red"


def check_drawing() -> None:
    """Before the work: `SaltusError` where figures cannot be drawn."""
    check_package("matplotlib", "paper", "figures need")


def subplots(
    rows: int = 1, columns: int = 1, height_in: float = 3.4, **options: Any
) -> tuple[Any, Any]:
    """A figure without a screen, and its axes."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    return plt.subplots(
        rows, columns, figsize=(WIDTH_IN, height_in), layout="constrained", **options
    )


def save(figure: Any, path: Path) -> None:
    """Writes a figure as PNG, and forgets it."""
    from matplotlib import pyplot as plt
    from PIL import Image

    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=DPI)
    plt.close(figure)
    colours = Image.open(drawn).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    colours.save(path, "PNG", optimize=True)


def legend(axis: Any, **options: Any) -> None:
    """Draws the legend, where anything is drawn."""
    if axis.get_legend_handles_labels()[0]:
        axis.legend(**options)


def draw_ground(axis: Any, terrain: Terrain, low: float, high: float) -> None:
    """The terrain along the middle of a course, from one x to another [m]."""
    edges = terrain.edges_x[(terrain.edges_x > low) & (terrain.edges_x < high)]
    x = np.unique(np.concatenate([np.linspace(low, high, 400), edges - 1e-6, edges + 1e-6]))
    z = terrain.height_at(x, np.zeros_like(x))
    axis.fill_between(x, z, float(np.min(z)) - 0.1, color=GROUND, linewidth=0)
    axis.set_xlim(low, high)


def draw_stance(axis: Any, time_s: Any, rows: Sequence[tuple[str, Any, Any]]) -> None:
    """Bars of what is to stand (light) and what bears (dark),
    one row for each name, from the top.
    """
    for place, (_, stands, bears) in enumerate(rows):
        for mask, colour, half in ((stands, "0.8", 0.4), (bears, "tab:red", 0.22)):
            axis.fill_between(
                time_s,
                place - half,
                place + half,
                where=mask,
                color=colour,
                step="post",
                linewidth=0,
            )
    axis.set_yticks(range(len(rows)), [name for name, _, _ in rows])
    axis.invert_yaxis()
