"""The dataset on disk: one HDF5 shard a round, written whole or not at all,
and a manifest with their checksums.
"""

import hashlib
import json
import os
import signal
import threading
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from saltus.config import UNNAMED, from_table
from saltus.constants import POLICY_DT
from saltus.depth import MODEL_CAMERA
from saltus.depth_camera import DepthCamera, recorded_camera
from saltus.effects.camera import NOMINAL_LATENCY
from saltus.effects.image_delivery import CameraLatency
from saltus.errors import ConfigError, SaltusError
from saltus.files import atomic_write, write_whole
from saltus.grid import HeightGrid, grid_metadata, load_grid
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.shard_columns import ShardColumn, check_own, read_column
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION
from saltus.provenance import current_commit

MANIFEST = "manifest.json"
_FORMAT = "saltus-heightmap-dataset-1"
LAYOUT = "layout"
PER_TICK = ("proprioception", "height", "state", "plan")
PER_FRAME = ("depth", "frame_tick")
SOMETIMES = ("state", "plan")
"""Columns that only datasets for imitation have."""
_NOT_OF_MOTION = ("episodes", "batches", "camera", "cameras", "latency", "plans", "renderer")
"""Settings that leave the motion of the first robots as it is."""


class DatasetError(SaltusError):
    """A dataset that is damaged, incomplete or missing."""


@dataclass(frozen=True, kw_only=True)
class ShardRecord:
    """Entry of one shard in a dataset's manifest."""

    file: str
    sha256: str
    episodes: int
    ticks: int
    frames: int
    seed: int
    commit: str
    config: dict[str, Any]

    @property
    def camera(self) -> DepthCamera:
        """Camera that took its images; older shards do not name theirs."""
        return recorded_camera(self.config.get("camera", "ideal"))

    @property
    def grid(self) -> HeightGrid:
        """Grid of its heights."""
        return grid_named(self.config)

    @property
    def latency(self) -> CameraLatency:
        """How long its images travel.

        Where nothing is said, as long as that camera's or a nominal one's.
        """
        own = self.camera.latency_s
        known = NOMINAL_LATENCY if own is None else CameraLatency(latency=own)
        return CameraLatency(**self.config.get("latency", asdict(known)))


class ShardWriter:
    """A shard that is being written; a pool of threads compresses it."""

    record: ShardRecord
    """Record of it in the manifest; there once it is written."""

    def __init__(self, file: h5py.File, pool: Executor) -> None:
        self._file, self._pool = file, pool
        self._columns: dict[str, ShardColumn] = {}
        self._rows: list[tuple[str, int, int]] = []

    @property
    def ticks(self) -> int:
        """Ticks of all episodes so far."""
        return sum(ticks for _, ticks, _ in self._rows)

    def append(self, episodes: Iterable[Episode]) -> None:
        """Adds episodes, which are consumed one by one.

        An interruption leaves those that are whole.
        """
        for episode in episodes:
            with without_interrupts():
                self._append(episode)

    def _append(self, episode: Episode) -> None:
        for name in (*PER_TICK, *PER_FRAME):
            rows = getattr(episode, name)
            if rows is None:
                continue
            if name not in self._columns:
                self._columns[name] = ShardColumn(self._file, name, rows, self._pool)
            self._columns[name].append(rows)
        self._rows.append((episode.terrain, len(episode.height), len(episode.depth)))

    def close(self, grid: HeightGrid) -> dict[str, int]:
        """Writes what is left, heights on a grid.

        Returns how much there is, `DatasetError` where that is nothing.
        """
        if not self._rows:
            raise DatasetError("no episodes to write")
        for column in self._columns.values():
            column.close()
        names, ticks, frames = zip(*self._rows, strict=True)
        self._file["terrain"] = np.array(names, dtype="S")
        self._file["ticks"] = np.array(ticks)
        self._file["frames"] = np.array(frames)
        self._file.attrs[LAYOUT] = json.dumps(layout(grid))
        return {"episodes": len(names), "ticks": sum(ticks), "frames": sum(frames)}


@contextmanager
def open_shard(
    directory: Path, *, seed: int, config: dict[str, object], code: str | None = None
) -> Iterator[ShardWriter]:
    """Adds a round to a dataset: at the end of the context the shard,
    whole, then the manifest that names it.

    `config` is what the episodes follow from besides the seed, in plain JSON values; `code` the
    commit of what makes them, where this machine cannot tell.

    Raises:
        DatasetError: the dataset has a round of this seed and configuration: episodes that come
            twice would be fitted and held out at once.
    """
    directory.mkdir(parents=True, exist_ok=True)
    records = read_manifest(directory)
    refuse_twice(directory, records, seed, config)
    grid = grid_named(config)
    name = f"round_{len(records):03d}.h5"
    with ExitStack() as ending, _said_in_one_line(directory / name):
        with (
            atomic_write(directory / name, synced=True) as temporary,
            _pool() as pool,
            h5py.File(temporary, "w") as file,
        ):
            writer = ShardWriter(file, pool)
            yield writer
            ending.enter_context(without_interrupts())
            counts = writer.close(grid)
        sha256 = file_sha256(directory / name)
        writer.record = ShardRecord(
            file=name,
            sha256=sha256,
            seed=seed,
            commit=code or current_commit(),
            config=config,
            **counts,
        )
        write_manifest(directory, [*records, writer.record])


@contextmanager
def _said_in_one_line(path: Path) -> Iterator[None]:
    """Says in one line what HDF5 says of a full disk in many."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename is not None:
            raise
        raise DatasetError(f"cannot write {path}: {os.strerror(error.errno)}") from error


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Ctrl-C waits for the end of what is done within:
    what it would cut in two could not be kept.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: heard.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if heard:
        signal.raise_signal(signal.SIGINT)


def motion_text(seed: int, config: dict[str, object]) -> str:
    """Text that two shards share if their robots move alike,
    however many there are and whatever camera looked on.
    """
    settings = {name: value for name, value in config.items() if name not in _NOT_OF_MOTION}
    return json.dumps([seed, settings], sort_keys=True)


def refuse_twice(
    directory: Path, records: Iterable[ShardRecord], seed: int, config: dict[str, object]
) -> None:
    """Raises `DatasetError` where a dataset has motion of this seed and configuration already."""
    for record in records:
        if motion_text(record.seed, record.config) == motion_text(seed, config):
            where = directory / record.file
            raise DatasetError(
                f"{where} holds the episodes of seed {seed} already: take another seed"
            )


def write_shard(
    directory: Path, episodes: Iterable[Episode], *, seed: int, config: dict[str, object]
) -> ShardRecord:
    """Adds a round of episodes to a dataset; arguments as those of `open_shard`."""
    with open_shard(directory, seed=seed, config=config) as shard:
        shard.append(episodes)
    return shard.record


def write_manifest(directory: Path, records: Iterable[ShardRecord]) -> None:
    """Replaces the manifest of a dataset, whole or not at all."""
    text = (
        json.dumps({"format": _FORMAT, "shards": [asdict(record) for record in records]}, indent=1)
        + "\n"
    )
    write_whole(directory / MANIFEST, text, synced=True)


def grid_named(config: Mapping[str, Any]) -> HeightGrid:
    """Grid that a manifest names; that of older ones, which name none."""
    return load_grid(config.get("grid", UNNAMED["grid"]))


def layout(grid: HeightGrid) -> dict[str, object]:
    """Meaning of the arrays' columns, kept in each shard."""
    return {
        **grid_metadata(grid),
        "proprioception": list(PROPRIOCEPTION),
        "camera": asdict(MODEL_CAMERA),
        "tick_s": POLICY_DT,
    }


def read_manifest(directory: Path) -> list[ShardRecord]:
    """The shards of a dataset, oldest first; none where there is no manifest."""
    path = directory / MANIFEST
    if not path.exists():
        return []
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        if table["format"] != _FORMAT:
            raise DatasetError(
                f"{path} has format '{table['format']}', this program reads '{_FORMAT}'"
            )
        records = [from_table(ShardRecord, record) for record in table["shards"]]
    except (OSError, ValueError, ConfigError, RecursionError) as error:
        raise DatasetError(f"{path} is damaged: {error}") from error
    except (KeyError, TypeError, AttributeError) as error:
        raise DatasetError(f"{path} is damaged: it is no table of shards") from error
    for record in records:
        if Path(record.file).name != record.file:
            raise DatasetError(f"{path} is damaged: '{record.file}' does not lie beside it")
    return records


def read_records(directory: Path) -> list[ShardRecord]:
    """Records of a dataset's shards; `DatasetError` where it is missing, damaged or empty."""
    records = read_manifest(directory)
    if not records:
        raise DatasetError(f"{directory} holds no dataset: '{MANIFEST}' is missing or empty")
    return records


def camera_of(directory: Path, records: Iterable[ShardRecord]) -> DepthCamera:
    """The camera that took the images of a dataset; where there are several, the first of them.

    Raises:
        DatasetError: they sat at different places.
    """
    cameras = [record.camera for record in records]
    if len({tuple(camera.mount.values()) for camera in cameras}) > 1:
        names = ", ".join(dict.fromkeys(camera.name for camera in cameras))
        raise DatasetError(
            f"{directory}: the cameras of its shards sit at different places: {names}"
        )
    return cameras[0]


def dataset_hash(records: Iterable[ShardRecord]) -> str:
    """First 16 hexadecimal digits of the sha256 over the shards' own."""
    return hashlib.sha256("".join(record.sha256 for record in records).encode()).hexdigest()[:16]


def read_dataset(directory: Path) -> list[Episode]:
    """All episodes of a dataset, as written;
    `DatasetError` where a shard is not what the manifest names.
    """
    records = read_records(directory)
    return [episode for record in records for episode in read_shard(directory, record)]


def read_shard(directory: Path, record: ShardRecord) -> list[Episode]:
    """All episodes of one shard, as written;
    `DatasetError` where it is not what the manifest names.
    """
    path = directory / record.file
    if not path.exists():
        raise DatasetError(f"{path} is missing: the manifest names it")
    if file_sha256(path) != record.sha256:
        raise DatasetError(f"{path} is not the file that the manifest names: its sha256 differs")
    with opened_shard(path) as file, _pool() as pool:
        there = [name for name in (*PER_TICK, *PER_FRAME) if name in file or name not in SOMETIMES]
        arrays = {name: read_column(file[name], pool) for name in there}
        kinds = [kind.decode() for kind in file["terrain"][:]]
        ticks, frames = np.cumsum(file["ticks"][:])[:-1], np.cumsum(file["frames"][:])[:-1]
    parts = {name: np.split(arrays[name], ticks if name in PER_TICK else frames) for name in arrays}
    each = [{name: parts[name][i] for name in parts} for i in range(len(kinds))]
    return [
        Episode(terrain=kind, latency=record.latency, **own)
        for kind, own in zip(kinds, each, strict=True)
    ]


@contextmanager
def opened_shard(path: Path) -> Iterator[h5py.File]:
    """A shard, to be read only; whatever is wrong with it is a `DatasetError` of one line.

    Nothing outside of the file is read, which HDF5 offers in three ways, and no more than it can
    hold.
    """
    try:
        with h5py.File(path, "r") as file:
            for name in file:
                check_own(file, name)
            yield file
    except DatasetError:
        raise
    except Exception as error:  # h5py and zlib raise anything on damaged structures
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise DatasetError(f"{path} cannot be read: {reason}") from error


def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(len(os.sched_getaffinity(0)))


def file_sha256(path: Path) -> str:
    """Hexadecimal sha256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
