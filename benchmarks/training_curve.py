"""Course of a training of the motion policy: the last row of the table that it writes,
and a picture of all.

A panel for each kind of terrain: the share of episodes that came to the end of the course,
exploring; the mean level of the courses; speed. Marks: what the deployed stack did with the policy
of that moment, where the training was evaluated with it, filled for its share of successes, hollow
for its speed.

    saltus bench training_curve -- runs/policy --picture training.png
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from numpy.typing import NDArray

from benchmarks._pictures import Pictured, save, subplots
from saltus.policy.training.background_evaluation import EvaluationRow, read_rows
from saltus.policy.training.standard_evaluation import course_of

Column = NDArray[np.float64]
_ACROSS = 5  # panels in a row: as wide as a page


@dataclass(frozen=True, kw_only=True)
class Benchmark(Pictured):
    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the training."""

    def measure(self) -> dict[str, Any]:
        """The last row."""
        table = read_columns(self.folder / "progress.csv")
        kinds = [name.removesuffix("/level") for name in table if name.endswith("/level")]
        if self.picture is not None:
            draw(table, read_rows(self.folder / "evaluation.csv"), kinds, self.picture)
        last = {name: float(table[name][-1]) for name in ("iteration", "steps", "seconds")}
        rows = {
            kind: {
                name: float(table[f"{kind}/{name}"][-1])
                for name in ("way_m", "speed", "level", "finished")
            }
            for kind in kinds
        }
        return {**last, "terrains": rows}


def read_columns(path: Path) -> dict[str, Column]:
    """The columns of `progress.csv`."""
    with path.open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    return {name: np.array([float(line[name]) for line in lines]) for name in lines[0]}


def draw(
    table: dict[str, Column], rows: Sequence[EvaluationRow], kinds: Sequence[str], path: Path
) -> None:
    """Draws the curves of some kinds of terrain over minutes."""
    across = min(_ACROSS, len(kinds))
    down = -(-len(kinds) // across)
    size = max(7.0, 3.2 * across), max(4.0, 2.5 * down)
    figure, axes = subplots(down, across, figsize=size, sharex=True, sharey=True, squeeze=False)
    for panel, kind in zip(axes.flat, kinds, strict=False):
        mine = [row for row in rows if course_of(row.course).terrain == kind]
        _draw_kind(panel, table, mine, kind)
    axes[0, 0].set_ylim(bottom=0.0)
    for panel in axes.flat[len(kinds) :]:
        panel.set_visible(False)
    lines = [line for line in axes[0, 0].get_lines() if not line.get_label().startswith("_")]
    figure.legend(
        lines,
        [line.get_label() for line in lines],
        loc="outside upper center",
        ncols=3,
        frameon=False,
    )
    figure.supxlabel(f"time [min]; {table['steps'][-1] / 1e6:.1f} million steps of training")
    save(figure, path)


def _draw_kind(
    panel: Any, table: dict[str, Column], rows: Sequence[EvaluationRow], kind: str
) -> None:
    minutes = table["seconds"] / 60.0
    panel.plot(minutes, table[f"{kind}/finished"], label="came to the end (share)")
    panel.plot(minutes, 0.1 * table[f"{kind}/level"], label="level (of the hardest)")
    panel.plot(minutes, table[f"{kind}/speed"], color="0.6", label="speed [m/s]")
    markers = zip(
        ("o", "s", "^"), ("C2", "C3", "C4"), dict.fromkeys(row.course for row in rows), strict=False
    )
    for marker, color, course in markers:
        mine = [row for row in rows if row.course == course]
        when = np.interp([row.iteration for row in mine], table["iteration"], minutes)
        style: dict[str, Any] = {
            "marker": marker,
            "color": color,
            "linestyle": "none",
            "markersize": 4,
        }
        panel.plot(when, [row.success_rate for row in mine], **style)
        panel.plot(when, [row.mean_speed_mps for row in mine], fillstyle="none", **style)
    panel.set_title(kind.replace("_", " "), fontsize=10)
    panel.grid(alpha=0.3)
