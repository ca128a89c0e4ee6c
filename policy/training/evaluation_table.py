"""Results of periodic evaluation, as rows of a CSV file."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from saltus.policy.tables import append_table, read_table


@dataclass(frozen=True, kw_only=True)
class EvaluationRow:
    """How one checkpoint did on one course."""

    iteration: int
    steps: int
    """Environment steps of the training so far, of one process."""
    course: str
    trials: int
    success_rate: float
    way_share: float
    """Mean distance along x over the distance to the finish: it rises long before the first
    success."""
    mean_speed_mps: float
    """Mean of successes; NaN where there are none."""
    time_p50_s: float
    """Mean of successes; NaN where there are none."""
    failures: str
    """Causes and how often, e.g. "edge_hit 3, slip 1"."""


def append_rows(table: Path, rows: Sequence[EvaluationRow]) -> None:
    """Adds rows to a CSV table, with a header where it begins."""
    append_table(table, [asdict(row) for row in rows])


def read_rows(table: Path) -> list[EvaluationRow]:
    """The rows of a table that `append_rows` wrote; none where there is no table."""
    types: dict[str, Any] = {f.name: f.type for f in fields(EvaluationRow)}
    return [
        EvaluationRow(**{name: types[name](text) for name, text in line.items()})
        for line in read_table(table)
    ]


def summary(rows: Sequence[EvaluationRow]) -> str:
    """One line for people: successes, way and time on each course."""
    parts = [
        f"{row.course} {100 * row.success_rate:.0f}% (way {100 * row.way_share:.0f}%"
        + ("" if math.isnan(row.time_p50_s) else f", {row.time_p50_s:.2f} s")
        + ")"
        for row in rows
    ]
    return f"deployed stack at iteration {rows[0].iteration}: " + ", ".join(parts)
