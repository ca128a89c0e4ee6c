"""`saltus heightmap benchmark`: a fixed split of depth to heights, and the one command that scores predictors on it."""

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from saltus.cli.heightmap_eval import BAR, COLUMNS
from saltus.cli.heightmap_train import QUIET_S
from saltus.cli.output import print_json, table_lines
from saltus.errors import ConfigError, nearest_hint
from saltus.flags import Flag, Group, Subcommands, shown
from saltus.models import model_id, model_path
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.workers import check_processes, in_order

if TYPE_CHECKING:
    from saltus.heightmap.evaluation.benchmark.files import Split
    from saltus.heightmap.evaluation.benchmark.rows import Row
    from saltus.heightmap.evaluation.held_out import Prediction

SPLIT = Path("runs/depth_to_heights")
Processes = Annotated[int | None, shown("INT", "one for each core")]


@dataclass(frozen=True, kw_only=True)
class Make:
    """Makes the split: what predictors are given (inputs.parquet), and what they are judged by (truth.parquet).

    For example:
      saltus heightmap benchmark make
      saltus heightmap benchmark make --runs 13 --out runs/few
    """

    out: Path = SPLIT
    """Folder to make."""
    runs: Annotated[int | None, shown("INT", "all")] = None
    """Only the first so many, for a try: what is scored on them is no row of the table."""
    processes: Processes = None
    """How many share the work."""

    def run(self) -> int:
        """Makes all of it."""
        from tqdm import tqdm

        from saltus.heightmap.evaluation.benchmark.files import refuse_folder, write_split
        from saltus.heightmap.evaluation.benchmark.split import RUNS, WORK, batches, make_batch, plans

        planned = plans(RUNS if self.runs is None else self.runs)
        check_processes(self.processes)
        refuse_folder(self.out)
        together = batches(planned)
        with tqdm(total=len(together) * WORK, desc="make", bar_format=BAR, delay=QUIET_S, file=sys.stderr) as bar:
            made = in_order(make_batch, together, self.processes, bar.update)
            split = write_split(self.out, planned, made)
        print(f"{self.out}: {_described(split)}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Score:
    """Scores predictors on the split: files of predictions, models, and the baselines that Saltus brings.

    A file of predictions is Parquet with one row for each row of inputs.parquet: episode_index, frame_index, height and
    half_width_90 (half of the 90 % interval), lists of 30 numbers in metres. Behind +- is half of the 90 % interval of
    a figure, over choices of the runs.

    For example:
      saltus heightmap benchmark score
      saltus heightmap benchmark score mine.parquet --json
      saltus heightmap benchmark score --heightmap-model runs/heightmap/heightmap.onnx --baselines geometric-feet
    """

    predictions: Annotated[tyro.conf.Positional[tuple[Path, ...]], shown("FILE ...", "none")] = ()
    """Files of predictions."""
    split: Path = SPLIT
    """Folder of the split."""
    baselines: Annotated[tuple[str, ...] | None, shown("NAME ...", "all, where nothing else is to be scored")] = None
    """flat: ground as high as the feet. newest: the newest image deprojected. geometric: those of 2 s, by the robot's
    odometry. geometric-feet: the same, moved to the standing feet. network: the shipped model."""
    heightmap_model: Annotated[Path | None, shown("PATH", "none")] = None
    """ONNX file of a network that Saltus trained."""
    processes: Processes = None
    """How many share the baselines. The numbers do not depend on it."""
    json: Flag = False
    """Print the result as one JSON object on the last line."""

    def run(self) -> int:
        """Prints a row for each, in millimetres."""
        from saltus.heightmap.evaluation.benchmark.files import read_predictions, read_split, read_truth
        from saltus.heightmap.evaluation.benchmark.predictors import NETWORK
        from saltus.heightmap.evaluation.benchmark.rows import row

        names = self._names()
        check_processes(self.processes)
        models = {name: model_path("heightmap") for name in names if name == NETWORK}
        if self.heightmap_model is not None:
            models[str(self.heightmap_model)] = self.heightmap_model
        _refuse_models(models)
        split = read_split(self.split)
        truths = read_truth(split)
        steps = [len(truth.height) for truth in truths]
        rows = [row(str(path), truths, read_predictions(path, steps)) for path in self.predictions]
        for name, said in self._predicted(split, names, models):
            rows.append(row(name, truths, said))
        _print(split, rows)
        if self.json:
            known = {name: value for name, value in vars(split).items() if name != "folder"} | {"whole": split.whole}
            ids = {name: model_id(path.read_bytes()) for name, path in models.items()}
            print_json({"split": known, "models": ids, "rows": {row.predictor: row.table for row in rows}})
        return 0

    def _names(self) -> tuple[str, ...]:
        """Of the baselines that are asked for."""
        from saltus.heightmap.evaluation.benchmark.predictors import BASELINES, NETWORK

        known = (*BASELINES, NETWORK)
        if self.baselines is None:
            return () if self.predictions or self.heightmap_model else known
        for name in self.baselines:
            if name not in known:
                raise ConfigError(f"unknown baseline '{name}': {nearest_hint(name, known)}")
        return self.baselines

    def _predicted(
        self, split: "Split", names: tuple[str, ...], models: Mapping[str, Path]
    ) -> "list[tuple[str, list[Prediction]]]":
        """What baselines and models say, run by run."""
        from tqdm import tqdm

        from saltus.heightmap.evaluation.benchmark.predictors import predict_run

        wanted = list(dict.fromkeys((*names, *models)))
        tasks = [(name, models.get(name), run) for name in wanted for run in range(split.runs)]
        with tqdm(total=len(tasks), desc="predict", bar_format=BAR, delay=QUIET_S, file=sys.stderr) as bar:
            said = []
            for prediction in in_order(partial(predict_run, split), tasks, self.processes):
                said.append(prediction)
                bar.update()
        return [(name, said[i * split.runs : (i + 1) * split.runs]) for i, name in enumerate(wanted)]


@dataclass(frozen=True, kw_only=True)
class Benchmark(Group):
    """The benchmark of depth to heights: make its split, score predictors on it (docs/benchmark.md)."""

    command: Subcommands[
        Annotated[Make, tyro.conf.subcommand("make")] | Annotated[Score, tyro.conf.subcommand("score")]
    ]


def _refuse_models(models: Mapping[str, Path]) -> None:
    """Says at once what is wrong with a model."""
    from saltus.heightmap.service.network import HeightmapNetwork
    from saltus.robots.loading import load_robot

    for path in models.values():
        HeightmapNetwork(load_robot(DEFAULT_ROBOT), path)


def _described(split: "Split") -> str:
    from saltus.heightmap.evaluation.benchmark.split import RUNS

    part = f"{split.runs} runs" if split.whole else f"only {split.runs} of {RUNS} runs: no rows of the table"
    return f"split {split.version}, {part}; definition {split.definition}, truth {split.truth}"


def _print(split: "Split", rows: "list[Row]") -> None:
    """A row for each predictor and, below it, each terrain; lengths in millimetres."""
    lines: list[tuple[str, Mapping[str, Any]]] = []
    for row in rows:
        cells: dict[str, Any] = {}
        for title, key, factor in COLUMNS:
            low, high = row.interval90[key]
            half = 0.5 * (high - low)
            cells[title] = _number(factor * row.figures[key]) + (f" +-{factor * half:.2f}" if half >= 0.0 else "")
        lines.append((row.predictor, cells))
        for kind, figures in row.by_terrain.items():
            lines.append((f"  {kind}", {title: _number(factor * figures[key]) for title, key, factor in COLUMNS}))
    print(_described(split), "error [mm]", *table_lines(lines), sep="\n")


def _number(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "-"
