"""Draws how a training went, from the table that it writes.

    python benchmarks/training_curve.py runs/policy [--kinds stairs gap] [--out docs/images/training.png]

A column for each kind of terrain. Above: the share of episodes that came to the end of the course, exploring, and the
mean level of the courses. Below: speed. Dots: what the deployed stack did with the policy of that moment, where the
training was evaluated with it. Ends with one JSON object.
"""

import argparse
import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from numpy.typing import NDArray

from saltus.policy.training.evaluation_table import Row, read_rows
from saltus.policy.training.standard_evaluation import COURSES
from saltus.terrain.batch import KINDS

Column = NDArray[np.float64]


def main(arguments: Sequence[str] | None = None) -> None:
    """Draws, and prints the last row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="of the training")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, help="of terrain; default: all that it trained on")
    parser.add_argument("--out", type=Path, help="picture; default: curve.png in the folder")
    given = parser.parse_args(arguments)
    table = read_columns(given.folder / "progress.csv")
    kinds = given.kinds or [kind for kind in KINDS if f"{kind}/level" in table]
    mpl.use("Agg")
    draw(table, read_rows(given.folder / "evaluation.csv"), kinds, given.out or given.folder / "curve.png")
    last = {name: float(table[name][-1]) for name in ("iteration", "steps", "seconds")}
    names = [f"{kind}/{name}" for kind in kinds for name in ("way_m", "speed", "level", "finished")]
    print(json.dumps(last | {name: float(table[name][-1]) for name in names}))


def read_columns(path: Path) -> dict[str, Column]:
    """The columns of `progress.csv`."""
    with path.open(newline="") as file:
        lines = list(csv.DictReader(file))
    return {name: np.array([float(line[name]) for line in lines]) for name in lines[0]}


def draw(table: dict[str, Column], rows: Sequence[Row], kinds: Sequence[str], path: Path) -> None:
    """Draws the curves of some kinds of terrain over minutes."""
    figure, axes = plt.subplots(
        2, len(kinds), figsize=(max(7.0, 4.0 * len(kinds)), 5.5), sharex=True, sharey="row", layout="constrained",
        squeeze=False,
    )  # fmt: skip
    for (above, below), kind in zip(axes.T, kinds, strict=True):
        mine = [row for row in rows if COURSES[row.course].terrain == kind]
        _draw_kind(above, below, table, mine, kind)
    axes[0, 0].set_ylim(0.0, 1.05)
    axes[1, 0].set_ylim(bottom=0.0)
    figure.suptitle(f"{table['steps'][-1] / 1e6:.1f} million steps of training")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_kind(above: Axes, below: Axes, table: dict[str, Column], rows: Sequence[Row], kind: str) -> None:
    minutes = table["seconds"] / 60.0
    above.plot(minutes, table[f"{kind}/finished"], label="came to the end")
    above.plot(minutes, 0.1 * table[f"{kind}/level"], label="level, of the hardest")
    below.plot(minutes, table[f"{kind}/speed"], label="in training [m/s]")
    markers = zip(("o", "s", "^"), ("C2", "C3", "C4"), dict.fromkeys(row.course for row in rows), strict=False)
    for marker, color, course in markers:
        mine = [row for row in rows if row.course == course]
        when = np.interp([row.iteration for row in mine], table["iteration"], minutes)
        style: dict[str, Any] = {"marker": marker, "color": color, "linestyle": "none"}
        above.plot(when, [row.success_rate for row in mine], label=f"deployed: {course}", **style)
        below.plot(when, [row.mean_speed_mps for row in mine], label=f"deployed: {course}", **style)
    above.set_title(kind.replace("_", " "))
    below.set_xlabel("time [min]")
    for axes in (above, below):
        axes.legend(fontsize=7, loc="lower right")
        axes.grid(alpha=0.3)


if __name__ == "__main__":
    main()
