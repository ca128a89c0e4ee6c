"""Which effects are taken for which: a matrix as a table and as a picture."""

import csv
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from benchmarks.hidden_effects.cases import Case
from benchmarks.hidden_effects.plan import LIBRARY

WIDTH, HEIGHT = 1000, 860
"""Size of the picture [px]."""
OTHER = ("several", "set", "unexplained", "no_gap", "bad_log", "error")


def matrix(cases: list[Case]) -> tuple[list[str], list[str], np.ndarray]:
    """Names of rows (what is true), of columns (what was said),
    and how often; shape (rows, columns).
    """
    effects = [name for names in LIBRARY.values() for name in names]
    rows = [*effects, "none", "outside", "damaged"]
    columns = [*effects, *OTHER]
    counts = np.zeros((len(rows), len(columns)), dtype=int)
    for case in cases:
        category = case.truth["category"]
        if category == "two" or (category == "one" and not case.counts()):
            continue
        row = case.true_names[0] if category in ("one", "play") else category
        named = case.named
        said = case.said
        if said == "named":
            said = named[0] if len(named) == 1 else "several"
        counts[rows.index(row), columns.index(said)] += 1
    return rows, columns, counts


def write_confusion(cases: list[Case], directory: Path) -> None:
    """Writes confusion.csv, confusion.html and runs.csv, a line for each run."""
    rows, columns, counts = matrix(cases)
    with (directory / "confusion.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["true", *columns])
        writer.writerows([name, *line] for name, line in zip(rows, counts.tolist(), strict=True))
    with (directory / "runs.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(
            [
                "run",
                "kind",
                "category",
                "counts",
                "separable",
                "true",
                "multiples",
                "verdict",
                "named",
                "sets",
            ]
        )
        writer.writerows(_line(case) for case in cases)
    shown = np.where(counts > 0, counts, np.nan)
    figure = go.Figure(
        go.Heatmap(
            z=shown,
            x=columns,
            y=rows,
            text=np.where(counts > 0, counts, "").astype(str),
            texttemplate="%{text}",
        )
    )
    figure.update_layout(
        width=WIDTH,
        height=HEIGHT,
        xaxis_title="said",
        yaxis_title="true",
        yaxis_autorange="reversed",
    )
    figure.update_layout(margin={"l": 10, "r": 10, "t": 10, "b": 10})
    figure.update_traces(colorscale="Blues", showscale=False, xgap=1, ygap=1)
    shown_alone = {"displayModeBar": False}
    figure.write_html(
        directory / "confusion.html", include_plotlyjs="directory", config=shown_alone
    )


def _line(case: Case) -> list[str]:
    truth = case.truth
    damaged = truth["category"] == "damaged"
    multiples = [] if damaged else [f"{multiple:.1f}" for multiple in truth["multiples"]]
    return [
        truth["name"],
        truth["kind"],
        truth["category"],
        str(not damaged and case.counts()),
        str(not damaged and case.separable()),
        " + ".join(case.true_names) or truth["damage"],
        " ".join(multiples),
        case.said,
        " + ".join(case.named),
        "; ".join(" | ".join(names) for names in case.verdict.get("sets", [])),
    ]
