"""A dataset in formats that others read: Parquet with a Croissant description,
and the layout of LeRobot.

One row a tick of 10 ms. The depth image in a row is the newest that was taken by then: how late
images come is drawn when a network is trained (`saltus.heightmap.data.delivery`), and no part of
the data.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from saltus.arrays import AnyArray
from saltus.constants import POLICY_DT
from saltus.files import whole_folder
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.export_columns import NO_IMAGE_S, ExportColumn, columns_of, nested_lists
from saltus.heightmap.data.shards import (
    DatasetError,
    ShardRecord,
    dataset_hash,
    read_records,
    read_shard,
)
from saltus.robots.shipped import robot_name_in

DATA_FILE = "data/chunk-000/file-{index:03d}.parquet"
EPISODES_FILE = "meta/episodes/chunk-000/file-000.parquet"
TASKS_FILE, INFO_FILE, STATS_FILE = "meta/tasks.parquet", "meta/info.json", "meta/stats.json"
CROISSANT_FILE = "croissant.json"
ROW_GROUP = 4096  # ticks: 6 MB of images, which a reader holds at once

EpisodeRow = TypedDict(
    "EpisodeRow",
    {
        "episode_index": int, "tasks": list[str], "length": int,
        "data/chunk_index": int, "data/file_index": int,
        "dataset_from_index": int, "dataset_to_index": int,
        "meta/episodes/chunk_index": int, "meta/episodes/file_index": int,
    },
)  # fmt: skip
"""A row of LeRobot's table of episodes."""


@dataclass(frozen=True, kw_only=True)
class ExportResult:
    """Counts of a dataset of heights that was exported for other programs."""

    episodes: int
    ticks: int
    terrains: tuple[str, ...]


def export_dataset(
    directory: Path, out: Path, done: Callable[[int], object] = lambda _: None
) -> ExportResult:
    """Writes all episodes of a dataset into a new folder, whole or not at all;
    `done` is told of rows as they come.

    The folder is a LeRobot dataset (v3.0), whose tables are plain Parquet, and has a Croissant
    description.

    Raises:
        DatasetError: no dataset there, a shard that is damaged, or `out` is there already.
    """
    records = read_records(directory)
    if out.exists():
        raise DatasetError(f"{out}: there is a file or folder of this name already")
    terrains: dict[str, int] = {}
    rows: list[EpisodeRow] = []
    columns = columns_of(records[0].grid)
    statistics = {column.name: _Statistics() for column in columns}
    schema = pa.schema([(column.name, column.kind) for column in columns])
    with whole_folder(out) as made:
        for number, record in enumerate(records):
            path = made / DATA_FILE.format(index=number)
            path.parent.mkdir(parents=True, exist_ok=True)
            with pq.ParquetWriter(path, schema, compression="zstd") as file:
                for episode in read_shard(directory, record):
                    table = _table(
                        episode,
                        len(rows),
                        _index(rows),
                        terrains.setdefault(episode.terrain, len(terrains)),
                    )
                    rows.append(_row(episode, rows, number))
                    for name, values in table.items():
                        statistics[name].add(values)
                    arrays = [nested_lists(table[column.name], column.kind) for column in columns]
                    file.write_table(pa.table(arrays, schema=schema), row_group_size=ROW_GROUP)
                    done(len(episode.height))
        _write_meta(made, robot_name_in(records[0].config), columns, rows, terrains, statistics)
        (made / CROISSANT_FILE).write_text(
            json.dumps(croissant(records), indent=1) + "\n", encoding="utf-8"
        )
    return ExportResult(episodes=len(rows), ticks=_index(rows), terrains=tuple(terrains))


def _index(rows: list[EpisodeRow]) -> int:
    """Index of the next row of the data."""
    return rows[-1]["dataset_to_index"] if rows else 0


def _table(episode: Episode, number: int, first: int, task: int) -> dict[str, AnyArray]:
    """Columns of one episode."""
    ticks = np.arange(len(episode.height))
    newest = np.searchsorted(episode.frame_tick, ticks, side="right") - 1
    seen = newest >= 0
    depth = np.where(seen[:, None, None], episode.depth[np.maximum(newest, 0)], np.uint16(0))
    age_s = np.where(
        seen, (ticks - episode.frame_tick[np.maximum(newest, 0)]) * POLICY_DT, NO_IMAGE_S
    )
    return {
        "observation.state": episode.proprioception,
        "observation.depth": depth,
        "observation.depth_age": age_s.astype(np.float32),
        "label.height": episode.height,
        "timestamp": (ticks * POLICY_DT).astype(np.float32),
        "frame_index": ticks,
        "episode_index": np.full(len(ticks), number),
        "index": first + ticks,
        "task_index": np.full(len(ticks), task),
    }


def _row(episode: Episode, rows: list[EpisodeRow], file: int) -> EpisodeRow:
    """Row of an episode in LeRobot's table."""
    first = _index(rows)
    return {
        "episode_index": len(rows), "tasks": [episode.terrain], "length": len(episode.height),
        "data/chunk_index": 0, "data/file_index": file,
        "dataset_from_index": first, "dataset_to_index": first + len(episode.height),
        "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0,
    }  # fmt: skip


class _Statistics:
    """Statistics of a column, over all rows."""

    def __init__(self) -> None:
        self._count, self._sum, self._squares, self._low, self._high = 0, 0.0, 0.0, np.inf, -np.inf

    def add(self, values: AnyArray) -> None:
        numbers = values.reshape(len(values), -1).astype(np.float64)
        self._count += len(numbers)
        self._sum, self._squares = self._sum + numbers.sum(0), self._squares + (numbers**2).sum(0)
        self._low, self._high = (
            np.minimum(self._low, numbers.min(0)),
            np.maximum(self._high, numbers.max(0)),
        )

    def table(self, shape: tuple[int, ...]) -> dict[str, object]:
        """As LeRobot's stats.json has them."""
        mean = self._sum / self._count
        deviation = np.sqrt(np.maximum(self._squares / self._count - mean**2, 0.0))
        pairs = {"min": self._low, "max": self._high, "mean": mean, "std": deviation}
        return {name: np.reshape(value, shape).tolist() for name, value in pairs.items()} | {
            "count": [self._count]
        }


def _write_meta(
    made: Path,
    robot: str,
    columns: Sequence[ExportColumn],
    rows: list[EpisodeRow],
    terrains: dict[str, int],
    statistics: dict[str, _Statistics],
) -> None:
    """Writes what LeRobot asks for besides the data."""
    (made / EPISODES_FILE).parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(rows), made / EPISODES_FILE)
    tasks = pa.table({"task_index": list(terrains.values()), "__index_level_0__": list(terrains)})
    kinds = [
        ("task_index", "task_index", "int64", "int64"),
        (None, "__index_level_0__", "unicode", "object"),
    ]
    keys = ("name", "field_name", "pandas_type", "numpy_type")
    index = {  # pandas: the names are those of the rows
        "index_columns": ["__index_level_0__"], "column_indexes": [],
        "columns": [dict(zip(keys, column, strict=True)) | {"metadata": None} for column in kinds],
    }  # fmt: skip
    pq.write_table(tasks.replace_schema_metadata({"pandas": json.dumps(index)}), made / TASKS_FILE)
    features = {
        column.name: {"dtype": column.dtype, "shape": column.shape, "names": column.names}
        for column in columns
    }
    info = {
        "codebase_version": "v3.0", "robot_type": robot, "total_episodes": len(rows),
        "total_frames": _index(rows), "total_tasks": len(terrains), "chunks_size": 1000,
        "data_files_size_in_mb": 100, "video_files_size_in_mb": 200,
        "fps": round(1.0 / POLICY_DT), "splits": {"train": f"0:{len(rows)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }  # fmt: skip
    (made / INFO_FILE).write_text(json.dumps(info, indent=1) + "\n", encoding="utf-8")
    stats = {column.name: statistics[column.name].table(column.shape) for column in columns}
    (made / STATS_FILE).write_text(json.dumps(stats) + "\n", encoding="utf-8")


def croissant(records: list[ShardRecord]) -> dict[str, object]:
    """The description of an exported dataset in Croissant 1.0 (JSON-LD)."""
    kinds = {"uint16": "sc:Integer", "int64": "sc:Integer", "float32": "sc:Float"}
    fields = [
        {
            "@type": "cr:Field", "@id": f"ticks/{column.name}", "name": f"ticks/{column.name}",
            "description": column.about, "dataType": kinds[column.dtype],
            "source": {"fileSet": {"@id": "tables"}, "extract": {"column": column.name}},
            **({"repeated": True} if column.shape != (1,) else {}),
        }
        for column in columns_of(records[0].grid)
    ]  # fmt: skip
    commits = ", ".join(dict.fromkeys(record.commit for record in records))
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "name": "saltus-depth-to-heights",
        "description": f"Noisy depth images of a robot ({robot_name_in(records[0].config)}) "
                       "that jumps over stairs, "
        "stones and gaps, what it knows of itself, and the true heights ahead of it, simulated by "
        "Saltus; 100 rows a "
        "second.",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "license": "https://www.apache.org/licenses/LICENSE-2.0",
        "version": "1.0.0",
        "citeAs": f"Saltus dataset {dataset_hash(records)}, made by commit {commits}",
        "distribution": [
            {
                "@type": "cr:FileSet", "@id": "tables", "name": "tables",
                "description": "One table for each shard.",
                "encodingFormat": "application/x-parquet", "includes": "data/*/*.parquet",
            },
        ],
        "recordSet": [
            {"@type": "cr:RecordSet", "@id": "ticks", "name": "ticks",
                "description": "One row for each 10 ms.",
             "field": fields},
        ],
    }  # fmt: skip


_CONTEXT = {
    "@language": "en", "@vocab": "https://schema.org/", "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo", "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/", "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"}, "extract": "cr:extract",
    "field": "cr:field", "fileProperty": "cr:fileProperty", "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet",
    "format": "cr:format", "includes": "cr:includes", "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key", "md5": "cr:md5", "parentField": "cr:parentField", "path": "cr:path",
    "recordSet": "cr:recordSet",
    "references": "cr:references", "regex": "cr:regex", "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate", "sc": "https://schema.org/", "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField", "transform": "cr:transform",
}  # fmt: skip
"""The context of every Croissant file (mlcommons.github.io/croissant, 1.0)."""
