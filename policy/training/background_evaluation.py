"""Evaluates checkpoints with the deployed stack beside a training,
on the processor, in processes of its own; results are rows of a CSV file.
"""

import importlib.util
import math
import os
import signal
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from saltus.policy.csv_tables import append_table, read_csv_table


@dataclass(frozen=True, kw_only=True)
class EvaluationRow:
    """The result of one checkpoint of a policy on one course."""

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
        for line in read_csv_table(table)
    ]


def evaluation_line(rows: Sequence[EvaluationRow]) -> str:
    """One line for people: successes, way and time on each course."""
    parts = [
        f"{row.course} {100 * row.success_rate:.0f}% (way {100 * row.way_share:.0f}%"
        + ("" if math.isnan(row.time_p50_s) else f", {row.time_p50_s:.2f} s")
        + ")"
        for row in rows
    ]
    return f"deployed stack at iteration {rows[0].iteration}: " + ", ".join(parts)


NEEDED = ("daqp", "onnx", "onnxruntime")
"""Packages that the deployed stack and its export need besides those of training."""
_SPARE_CORES = (
    2  # for the training itself: one for its process, one for what the driver of a GPU does
)


def missing_packages() -> list[str]:
    """Packages of `NEEDED` that are not installed:
    a machine that trains need not be able to deploy.
    """
    return [name for name in NEEDED if importlib.util.find_spec(name) is None]


class BackgroundEvaluation:
    """Runs `saltus.policy.training.standard_evaluation` every so often, one at a time.

    Never waits for it.

    Rows are added to `table`, a CSV. `processes` run trials at once, by default one for each core
    but two.
    """

    def __init__(
        self,
        table: Path,
        kinds: Iterable[str],
        *,
        every_s: float,
        trials: int,
        processes: int | None = None,
    ) -> None:
        self._table, self._kinds, self._trials = table, list(kinds), trials
        self.every_s = every_s
        """Time from the start of one evaluation to the next, at least [s]."""
        self._processes = processes or max(1, (os.cpu_count() or 1) - _SPARE_CORES)
        self._seen = len(read_rows(table))
        self._started_s: float | None = None
        self._process: subprocess.Popen[bytes] | None = None

    def due(self, now_s: float) -> bool:
        """True where an evaluation is due and none is running.

        The first is due `every_s` after the first call.
        """
        if self._started_s is None:
            self._started_s = now_s
        return self._process is None and now_s - self._started_s >= self.every_s

    def start(self, checkpoint: Path, now_s: float) -> None:
        """Begins to evaluate a checkpoint, which may be replaced by the next one,
        but not changed.
        """
        self._started_s = now_s
        command = [sys.executable, "-P", "-m", "saltus.policy.training.standard_evaluation"]
        command += [str(checkpoint), str(self._table), "--trials", str(self._trials)]
        command += ["--processes", str(self._processes), "--kinds", *self._kinds]
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}
        self._process = subprocess.Popen(  # a group of its own, so that its workers end with it
            command, env=environment, stdout=subprocess.DEVNULL, start_new_session=True
        )

    def finished(self) -> list[EvaluationRow]:
        """The rows of an evaluation that has ended since the last call; none where it failed."""
        if self._process is None or self._process.poll() is None:
            return []
        self._process = None
        rows = read_rows(self._table)
        new, self._seen = rows[self._seen :], len(rows)
        return new

    def wait(self, timeout_s: float) -> None:
        """Waits for a running evaluation to end, but no longer than this."""
        if self._process is not None:
            self._process.wait(timeout_s)

    def close(self) -> None:
        """Ends an evaluation that is still running."""
        if self._process is not None and self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        self._process = None
