"""Draws how a training went, from the table that it writes.

    python benchmarks/training_curve.py runs/flat [--kind flat] [--out docs/images/training_flat.png]

Above: the way of an episode along the course's profile and the mean level. Below: speed along it. Dots: what the
deployed stack did with the policy of that moment, where the training was evaluated with it. Ends with one JSON object.
"""

import argparse
import csv
import json
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from policy.evaluation_table import Row, read_rows
from policy.standard_evaluation import COURSES
from saltus.terrain.batch import KINDS

Column = NDArray[np.float64]


def main(arguments: Sequence[str] | None = None) -> None:
    """Draws, and prints the last row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="of the training")
    parser.add_argument("--kind", choices=KINDS, default="flat", help="of terrain")
    parser.add_argument("--out", type=Path, help="picture; default: curve.png in the folder")
    given = parser.parse_args(arguments)
    table = read_columns(given.folder / "progress.csv")
    rows = [row for row in read_rows(given.folder / "evaluation.csv") if COURSES[row.course].terrain == given.kind]
    mpl.use("Agg")
    draw(table, rows, given.kind, given.out or given.folder / "curve.png")
    last = {name: float(table[name][-1]) for name in ("iteration", "steps", "seconds")}
    print(json.dumps(last | {name: float(table[f"{given.kind}/{name}"][-1]) for name in ("way_m", "speed", "level")}))


def read_columns(path: Path) -> dict[str, Column]:
    """The columns of `progress.csv`."""
    with path.open(newline="") as file:
        lines = list(csv.DictReader(file))
    return {name: np.array([float(line[name]) for line in lines]) for name in lines[0]}


def draw(table: dict[str, Column], rows: Sequence[Row], kind: str, path: Path) -> None:
    """Draws the curves of one kind of terrain over minutes."""
    minutes = table["seconds"] / 60.0
    figure, (above, below) = plt.subplots(2, 1, figsize=(7.0, 5.0), sharex=True, layout="constrained")
    above.plot(minutes, table[f"{kind}/way_m"], label="way of an episode [m]")
    above.plot(minutes, table[f"{kind}/level"], label="mean level of 10")
    below.plot(minutes, table[f"{kind}/speed"], label="speed in training [m/s]")
    for course in dict.fromkeys(row.course for row in rows):
        mine = [row for row in rows if row.course == course]
        when = np.interp([row.iteration for row in mine], table["iteration"], minutes)
        above.plot(when, [10.0 * row.success_rate for row in mine], "o", label=f"deployed, successes of 10, {course}")
        below.plot(when, [row.mean_speed_mps for row in mine], "o", label=f"deployed [m/s], {course}")
    above.set_title(f"Training on {kind.replace('_', ' ')}, {table['steps'][-1] / 1e6:.1f} million steps")
    below.set_xlabel("time [min]")
    for axes in (above, below):
        axes.legend(fontsize=8)
        axes.grid(alpha=0.3)
        axes.set_ylim(bottom=0.0)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    main()
