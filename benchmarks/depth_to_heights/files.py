"""A split on disk, and the file of predictions that is scored on it:
plain Parquet, one row each 10 ms of a run.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from benchmarks.depth_to_heights.split import (
    OBSERVED,
    RUNS,
    VERSION,
    Inputs,
    RunPlan,
    SplitRun,
    Truth,
    definition,
    truth_digest,
)
from saltus.arrays import Floats
from saltus.errors import SaltusError
from saltus.files import whole_folder
from saltus.folders import ask_for_room
from saltus.grid import LINE
from saltus.heightmap.data.export_columns import columns_of, nested_lists
from saltus.heightmap.evaluation.held_out import HeldOutPrediction
from saltus.provenance import current_commit

INPUTS, TRUTH, SPLIT = "inputs.parquet", "truth.parquet", "split.json"
RUN, STEP = "episode_index", "frame_index"
HEIGHT, HALF_WIDTH = "height", "half_width_90"
MOST_M = 10.0
"""Heights farther from the base than this are no metres: courses reach 4 m in all."""
_STATE, _DEPTH, _AGE = "observation.state", "observation.depth", "observation.depth_age"
_ROBOT = "observation."
_POINTS = LINE.size
_VECTOR = pa.list_(pa.float32())


class BenchmarkError(SaltusError):
    """A folder that holds no split, or a file of predictions that cannot be scored."""


@dataclass(frozen=True, kw_only=True)
class StoredSplit:
    """A split on disk, as its description says."""

    folder: Path
    version: int
    runs: int
    definition: str
    """See `benchmarks.depth_to_heights.split.definition`."""
    truth: str
    """See `benchmarks.depth_to_heights.split.truth_digest`."""
    inputs: str
    """sha256 of the file of inputs."""
    commit: str
    """Commit of the code that made it."""

    @property
    def table(self) -> dict[str, Any]:
        """All but the folder as plain values; `whole` says that rows of the table may be of it."""
        return {name: value for name, value in vars(self).items() if name != "folder"} | {
            "whole": self.runs == RUNS
        }


def write_split(
    folder: Path,
    plans: Sequence[RunPlan],
    made: Iterable[Sequence[SplitRun]],
    done: Callable[[int], object] = lambda _: None,
) -> StoredSplit:
    """Writes runs, whole or not at all; `done` is told how many there are so far.

    Raises:
        BenchmarkError: the folder is there already.
    """
    refuse_folder(folder)
    truths: list[Truth] = []
    with whole_folder(folder) as partial:
        inputs = pq.ParquetWriter(partial / INPUTS, _INPUTS, compression="zstd")
        truth = pq.ParquetWriter(partial / TRUTH, _TRUTH, compression="zstd")
        with inputs, truth:
            for batch in made:
                for run in batch:
                    inputs.write_table(_input_table(len(truths), run.inputs))
                    truth.write_table(_truth_table(len(truths), run.truth))
                    truths.append(run.truth)
                done(len(truths))
        split = StoredSplit(
            folder=folder, version=VERSION, runs=len(truths), definition=definition(plans),
            truth=truth_digest(truths),
            inputs=_sha256(partial / INPUTS), commit=current_commit(),
        )  # fmt: skip
        known = {name: value for name, value in vars(split).items() if name != "folder"}
        (partial / SPLIT).write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
    return split


def refuse_folder(folder: Path) -> None:
    """Before the work: `BenchmarkError` for a folder that is there,
    `SaltusError` for one that cannot be made.
    """
    if folder.exists():
        raise BenchmarkError(f"{folder}: there is a file or folder of this name already")
    ask_for_room(folder.parent)


def read_split(folder: Path) -> StoredSplit:
    """Reads the description of a split.

    Raises:
        BenchmarkError: there is none, it is of another version, or its inputs are not those that
            were written.
    """
    try:
        split = StoredSplit(
            folder=folder, **json.loads((folder / SPLIT).read_text(encoding="utf-8"))
        )
        inputs = _sha256(folder / INPUTS)
    except (OSError, ValueError, TypeError) as error:
        raise BenchmarkError(
            f"{folder} holds no split: saltus bench depth_to_heights make --out {folder}"
        ) from error
    if split.version != VERSION:
        raise BenchmarkError(
            f"{folder} is a split of version {split.version}, not {VERSION}: make it anew"
        )
    if split.inputs != inputs:
        raise BenchmarkError(f"{folder / INPUTS} is not what was made: make it anew")
    return split


def read_truth(split: StoredSplit) -> list[Truth]:
    """Reads what predictions are judged by, run by run.

    Raises:
        BenchmarkError: it is not what was made.
    """
    try:
        file = pq.ParquetFile(split.folder / TRUTH)
        tables = [file.read_row_group(number) for number in range(file.num_row_groups)]
        truths = [
            Truth(
                terrain=table["terrain"][0].as_py(),
                height=_rows(table["height"], np.float32),
                view=_rows(table["view"], np.int8),
            )
            for table in tables
        ]
    except (OSError, ValueError, KeyError, IndexError, pa.ArrowException) as error:
        raise BenchmarkError(
            f"cannot read {split.folder / TRUTH}: {str(error).splitlines()[0]}"
        ) from error
    if len(truths) != split.runs or truth_digest(truths) != split.truth:
        raise BenchmarkError(f"{split.folder / TRUTH} is not what was made: make it anew")
    return truths


def read_inputs(split: StoredSplit, run: int) -> Inputs:
    """Reads what predictors are given of one run."""
    table = pq.ParquetFile(split.folder / INPUTS).read_row_group(run)
    return Inputs(
        proprioception=_rows(table[_STATE], np.float32),
        depth=_rows(table[_DEPTH], np.uint16).reshape(table.num_rows, *_COLUMNS[_DEPTH].shape),
        depth_age_s=table[_AGE].to_numpy(),
        robot={name: _rows(table[_ROBOT + name], None) for name in OBSERVED},
    )


def write_predictions(path: Path, predictions: Sequence[HeldOutPrediction]) -> None:
    """Writes what `read_predictions` reads, run by run."""
    with pq.ParquetWriter(path, _PREDICTIONS, compression="zstd") as file:
        for run, said in enumerate(predictions):
            numbers = {RUN: np.full(len(said.height), run), STEP: np.arange(len(said.height))}
            file.write_table(
                _table(
                    numbers | {HEIGHT: said.height, HALF_WIDTH: said.half_width_90}, _PREDICTIONS
                )
            )


def read_predictions(path: Path, steps: Sequence[int]) -> list[HeldOutPrediction]:
    """Predictions of all runs, each of so many steps; their rows may come in any order.

    Raises:
        BenchmarkError: it cannot be read; a row is missing, stands twice or is of no run; a height
            is no number of metres, or an interval is not wider than 0.
    """
    table = _read_columns(path, sum(steps))
    run, step = (_column(path, table, name, pa.int64()).to_numpy() for name in (RUN, STEP))
    order = np.lexsort((step, run))
    run, step = run[order], step[order]
    _check_rows(path, run, step, steps)
    height, half_width = (_matrix(path, table, name)[order] for name in (HEIGHT, HALF_WIDTH))
    for values, name, least in ((height, HEIGHT, -MOST_M), (half_width, HALF_WIDTH, 0.0)):
        wrong = ~((values >= least) & (values <= MOST_M)) | ((values == 0.0) & (name == HALF_WIDTH))
        if wrong.any():
            row, point = np.argwhere(wrong)[0]
            allowed = f"from {least:g}" if least else "above 0 and"
            raise BenchmarkError(
                f"{path}: {RUN} {run[row]}, {STEP} {step[row]}: '{name}' of point {point} is "
                f"{values[row, point]:g}; "
                f"it must be {allowed} to {MOST_M:g} m"
            )
    ends = np.cumsum(steps)
    return [
        HeldOutPrediction(
            height=height[end - count : end], half_width_90=half_width[end - count : end]
        )
        for count, end in zip(steps, ends, strict=True)
    ]


def _check_rows(
    path: Path, run: NDArray[np.int64], step: NDArray[np.int64], steps: Sequence[int]
) -> None:
    """Refuses sorted rows that are not those of the runs, each once."""
    known = (run >= 0) & (run < len(steps))
    known[known] = (step[known] >= 0) & (step[known] < np.asarray(steps)[run[known]])
    if not known.all():
        row = int(np.argmin(known))
        raise BenchmarkError(
            f"{path}: the split has no row with {RUN} {run[row]} and {STEP} {step[row]}"
        )
    twice = (np.diff(run) == 0) & (np.diff(step) == 0)
    if twice.any():
        row = int(np.argmax(twice))
        raise BenchmarkError(
            f"{path}: the row with {RUN} {run[row]} and {STEP} {step[row]} stands twice"
        )
    starts = np.cumsum([0, *steps[:-1]])
    if len(run) < sum(steps):
        there = np.zeros(sum(steps), np.bool_)
        there[starts[run] + step] = True
        row = int(np.argmin(there))
        lacks = int(np.searchsorted(starts, row, side="right")) - 1
        raise BenchmarkError(
            f"{path}: the row with {RUN} {lacks} and {STEP} {row - starts[lacks]} is missing"
        )


def _read_columns(path: Path, rows: int) -> pa.Table:
    """The columns of predictions.

    Not those of a file that would take much more memory than predictions do.
    """
    wanted = _PREDICTIONS.names
    try:
        file = pq.ParquetFile(path)
        groups = [file.metadata.row_group(i) for i in range(file.num_row_groups)]
        most = max(
            sum(group.column(j).num_values for group in groups)
            for j in range(file.metadata.num_columns)
        )
        missing = [name for name in wanted if name not in file.schema_arrow.names]
        if missing:
            raise ValueError(f"column '{missing[0]}' is missing: it needs {', '.join(wanted)}")
        if file.metadata.num_rows > 2 * rows or most > 2 * rows * _POINTS:
            raise ValueError(f"it has {file.metadata.num_rows} rows, the split has {rows}")
        return file.read(wanted)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise BenchmarkError(f"cannot read {path}: {str(error).splitlines()[0]}") from error


def _column(path: Path, table: pa.Table, name: str, kind: pa.DataType) -> pa.ChunkedArray:
    try:
        column = table[name].cast(kind)
    except pa.ArrowException as error:
        raise BenchmarkError(
            f"{path}: column '{name}' is {table[name].type}; it must be {kind}"
        ) from error
    if column.null_count:
        raise BenchmarkError(
            f"{path}: column '{name}' has {column.null_count} rows without a value"
        )
    return column


def _matrix(path: Path, table: pa.Table, name: str) -> Floats:
    """A column of lists of one number for each point."""
    column = _column(path, table, name, pa.list_(pa.float64()))
    lengths = column.combine_chunks().value_lengths().to_numpy(zero_copy_only=False)
    if (lengths != _POINTS).any():
        raise BenchmarkError(
            f"{path}: a list of '{name}' has {lengths[lengths != _POINTS][0]} numbers; it must "
            f"have {_POINTS}"
        )
    return _rows(column, np.float64)


def _rows(column: pa.ChunkedArray, kind: Any) -> NDArray[Any]:
    """A column as an array with a row for each of its own; lists in it become dimensions."""
    values, rows = column.combine_chunks(), len(column)
    is_nested = pa.types.is_list(values.type)
    while pa.types.is_list(values.type):
        values = values.flatten()
    array = values.to_numpy(zero_copy_only=False).astype(kind or values.type.to_pandas_dtype())
    return array.reshape(rows, -1) if is_nested else array


def _input_table(run: int, inputs: Inputs) -> pa.Table:
    steps = len(inputs.depth)
    columns: dict[str, NDArray[Any]] = {RUN: np.full(steps, run), STEP: np.arange(steps)}
    columns |= {_STATE: inputs.proprioception, _DEPTH: inputs.depth, _AGE: inputs.depth_age_s}
    return _table(
        columns | {_ROBOT + name: values for name, values in inputs.robot.items()}, _INPUTS
    )


def _truth_table(run: int, truth: Truth) -> pa.Table:
    steps = len(truth.height)
    columns = {
        RUN: np.full(steps, run),
        STEP: np.arange(steps),
        "terrain": np.full(steps, truth.terrain, object),
    }
    return _table(columns | {"height": truth.height, "view": truth.view}, _TRUTH)


def _table(columns: dict[str, NDArray[Any]], schema: pa.Schema) -> pa.Table:
    return pa.table(
        [nested_lists(columns[field.name], field.type) for field in schema], schema=schema
    )


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


_COLUMNS = {column.name: column for column in columns_of(LINE)}
_OBSERVED_KINDS = {
    "base_height": pa.float32(),
    "leg_contact": pa.list_(pa.bool_()),
    "leg_trusted": pa.list_(pa.bool_()),
}
_NUMBERS = [(name, _COLUMNS[name].kind) for name in (RUN, STEP)]
_INPUTS = pa.schema(
    [
        *_NUMBERS,
        *((name, _COLUMNS[name].kind) for name in (_STATE, _DEPTH, _AGE)),
        *((_ROBOT + name, _OBSERVED_KINDS.get(name, _VECTOR)) for name in OBSERVED),
    ]
)
_TRUTH = pa.schema(
    [*_NUMBERS, ("terrain", pa.string()), ("height", _VECTOR), ("view", pa.list_(pa.int8()))]
)
_PREDICTIONS = pa.schema([*_NUMBERS, (HEIGHT, _VECTOR), (HALF_WIDTH, _VECTOR)])
