"""Scores of heights that somebody predicts from depth images,
on a fixed split of runs (docs/benchmark.md).

saltus bench depth_to_heights -- make
saltus bench depth_to_heights -- score mine.parquet
"""

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from tqdm import tqdm
from tyro.conf import Positional, subcommand

from benchmarks.depth_to_heights.files import (
    StoredSplit,
    read_predictions,
    read_split,
    read_truth,
    refuse_folder,
    write_split,
)
from benchmarks.depth_to_heights.predictors import BASELINES, NETWORK, predict_run
from benchmarks.depth_to_heights.rows import row
from benchmarks.depth_to_heights.split import RUNS, WORK, batches, make_batch, plans
from saltus.cli.heightmap_measures import COLUMNS
from saltus.cli.output import table_lines
from saltus.errors import ConfigError, nearest_hint
from saltus.flags import Flag, flag_help
from saltus.heightmap.evaluation.held_out import HeldOutPrediction
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.used_networks import model_id, model_path
from saltus.workers import check_processes, in_order

SPLIT = Path("runs/depth_to_heights")


@dataclass(frozen=True, kw_only=True)
class _Part:
    processes: Annotated[int | None, flag_help("INT", "one for each core")] = None
    """Number of processes that share the work. The numbers do not depend on it."""
    json: Flag = False
    """Print the result as one JSON object on the last line."""


@dataclass(frozen=True, kw_only=True)
class Make(_Part):
    """Makes the split: what predictors are given (inputs.parquet),
    and what they are judged by (truth.parquet).
    """

    out: Path = SPLIT
    """Folder to make."""
    runs: Annotated[int | None, flag_help("INT", "all")] = None
    """Only the first so many, for a try: what is scored on them is no row of the table."""

    def measure(self) -> dict[str, Any]:
        planned = plans(RUNS if self.runs is None else self.runs)
        check_processes(self.processes)
        refuse_folder(self.out)
        together = batches(planned)
        with tqdm(total=len(together) * WORK, desc="make", file=sys.stderr, disable=None) as bar:
            made = in_order(make_batch, together, self.processes, bar.update)
            split = write_split(self.out, planned, made)
        return {"folder": str(self.out), "split": split.table}


@dataclass(frozen=True, kw_only=True)
class Score(_Part):
    """Scores predictors on the split: files of predictions,
    models, and the baselines that Saltus brings.

    A file of predictions is Parquet with one row for each row of inputs.parquet: episode_index,
    frame_index, height and half_width_90 (half of the 90 % interval), lists of 30 numbers in
    metres. Behind +- is half of the 90 % interval of a figure, over choices of the runs.
    """

    predictions: Annotated[Positional[tuple[Path, ...]], flag_help("FILE ...", "none")] = ()
    """Files of predictions."""
    split: Path = SPLIT
    """Folder of the split."""
    baselines: Annotated[
        tuple[str, ...] | None, flag_help("NAME ...", "all, where nothing else is to be scored")
    ] = None
    """flat: ground as high as the feet. newest: the newest image deprojected. geometric: those of
    2 s, by the robot's odometry. geometric-feet: the same, moved to the standing feet. network: the
    shipped model."""
    heightmap_model: Annotated[Path | None, flag_help("PATH", "none")] = None
    """ONNX file of a network that Saltus trained."""

    def measure(self) -> dict[str, Any]:
        names = self._names()
        check_processes(self.processes)
        models = {name: model_path("heightmap") for name in names if name == NETWORK}
        if self.heightmap_model is not None:
            models[str(self.heightmap_model)] = self.heightmap_model
        for path in models.values():
            HeightmapNetwork(load_robot(DEFAULT_ROBOT), path)  # says at once what is wrong with it
        split = read_split(self.split)
        truths = read_truth(split)
        steps = [len(truth.height) for truth in truths]
        rows = [row(str(path), truths, read_predictions(path, steps)) for path in self.predictions]
        for name, said in self._predicted(split, names, models):
            rows.append(row(name, truths, said))
        ids = {name: model_id(path.read_bytes()) for name, path in models.items()}
        return {
            "split": split.table,
            "models": ids,
            "rows": {row.predictor: row.table for row in rows},
        }

    def show(self, figures: Mapping[str, Any]) -> None:
        """Prints a row for each predictor and, below it, each terrain; lengths in millimetres."""
        split, lines = figures["split"], list[tuple[str, Mapping[str, Any]]]()
        for predictor, of_row in figures["rows"].items():
            cells: dict[str, Any] = {}
            for title, key, factor in COLUMNS:
                low, high = of_row["interval90"][key]
                half = 0.5 * (high - low)
                cells[title] = _number(factor * of_row[key]) + (
                    f" +-{factor * half:.2f}" if half >= 0.0 else ""
                )
            lines.append((predictor, cells))
            for kind, of_kind in of_row["by_terrain"].items():
                lines.append(
                    (
                        f"  {kind}",
                        {title: _number(factor * of_kind[key]) for title, key, factor in COLUMNS},
                    )
                )
        part = "" if split["whole"] else f" of {RUNS}: no rows of the table"
        print(
            f"split {split['version']}, {split['runs']} runs{part}; definition "
            f"{split['definition']}, "
            f"truth {split['truth']}"
        )
        print("error [mm]", *table_lines(lines), sep="\n")

    def _names(self) -> tuple[str, ...]:
        """Names of the baselines that are asked for."""
        known = (*BASELINES, NETWORK)
        if self.baselines is None:
            return () if self.predictions or self.heightmap_model else known
        for name in self.baselines:
            if name not in known:
                raise ConfigError(f"unknown baseline '{name}': {nearest_hint(name, known)}")
        return self.baselines

    def _predicted(
        self, split: StoredSplit, names: tuple[str, ...], models: Mapping[str, Path]
    ) -> list[tuple[str, list[HeldOutPrediction]]]:
        """Predictions of baselines and models, run by run."""
        wanted = list(dict.fromkeys((*names, *models)))
        tasks = [(name, models.get(name), run) for name in wanted for run in range(split.runs)]
        predicted = in_order(partial(predict_run, split), tasks, self.processes)
        said = list(tqdm(predicted, "predict", len(tasks), file=sys.stderr, disable=None))
        return [
            (name, said[i * split.runs : (i + 1) * split.runs]) for i, name in enumerate(wanted)
        ]


def _number(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "-"


Benchmark = Annotated[Make, subcommand("make")] | Annotated[Score, subcommand("score")]
