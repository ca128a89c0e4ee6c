"""Inventory of a dataset: what it holds, whether it is undamaged, and how several are merged."""

import json
import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import DTypeLike

from saltus.files import atomic_write
from saltus.heightmap.data.shards import (
    LAYOUT,
    PER_FRAME,
    PER_TICK,
    SOMETIMES,
    DatasetError,
    ShardRecord,
    camera_of,
    dataset_hash,
    file_sha256,
    opened_shard,
    read_manifest,
    read_records,
    write_manifest,
)

_KINDS = {"depth": np.uint16, "frame_tick": np.int32, **dict.fromkeys(PER_TICK, np.float32)}
_DIMENSIONS = {"depth": 3, "frame_tick": 1, **dict.fromkeys(PER_TICK, 2)}


@dataclass(frozen=True, kw_only=True)
class ShardInfo:
    """Summary of one shard of a dataset, for people."""

    record: ShardRecord
    terrains: dict[str, int]
    """Episodes on each kind of terrain."""
    camera: str
    """Camera that took its images: name and fingerprint."""


@dataclass(frozen=True, kw_only=True)
class DatasetInfo:
    """Summary of a dataset and its shards, for people."""

    dataset: str
    """Its hash."""
    shards: tuple[ShardInfo, ...]


def dataset_info(directory: Path) -> DatasetInfo:
    """Contents of a dataset.

    Its shards are opened, but not checked (`DatasetError` where that fails).
    """
    records = read_records(directory)
    shards = []
    for record in records:
        with opened_shard(directory / record.file) as file:
            terrains = Counter(name.decode() for name in file["terrain"][:])
        camera = f"{record.camera.name} {record.camera.fingerprint}"
        shards.append(
            ShardInfo(record=record, terrains=dict(sorted(terrains.items())), camera=camera)
        )
    return DatasetInfo(dataset=dataset_hash(records), shards=tuple(shards))


def validate_dataset(directory: Path) -> list[str]:
    """Damages of a dataset, shard by shard; none where it is sound.

    Raises:
        DatasetError: no dataset there, or its manifest is damaged.
    """
    records = read_records(directory)
    damages = [damage for record in records for damage in _damages(directory / record.file, record)]
    first: dict[str, ShardRecord] = {}
    for record in records:
        if first.setdefault(record.sha256, record) is not record:
            damages.append(
                f"{directory / record.file} holds the episodes of {first[record.sha256].file} once "
                "more"
            )
    return damages


def merge_datasets(sources: Sequence[Path], out: Path) -> list[ShardRecord]:
    """Joins datasets into a new one: all shards in their order, those that are there twice once.

    The manifest comes last, so that an interrupted merge is no dataset yet.

    Raises:
        DatasetError: there are no sources, one is missing or damaged, their arrays differ in
            meaning (the message names the field), or `out` already is a dataset.
    """
    if not sources:
        raise DatasetError("nothing to merge: name the folders of datasets")
    if read_manifest(out):
        raise DatasetError(f"{out} already is a dataset: name a new folder")
    found = {
        record.sha256: source / record.file
        for source in reversed(sources)
        for record in read_records(source)
    }
    records = {record.sha256: record for source in sources for record in read_records(source)}
    for sha256, record in records.items():
        if damages := _damages(found[sha256], record):
            raise DatasetError(damages[0])
    _compare([found[sha256] for sha256 in records])
    camera_of(out, records.values())
    out.mkdir(parents=True, exist_ok=True)
    merged = [
        replace(record, file=f"round_{i:03d}.h5") for i, record in enumerate(records.values())
    ]
    try:
        for record in merged:
            with atomic_write(out / record.file, synced=True) as partial:
                shutil.copyfile(found[record.sha256], partial)
        write_manifest(out, merged)
    except OSError as error:
        raise DatasetError(f"cannot write into {out}: {error.strerror}") from error
    return merged


def _damages(path: Path, record: ShardRecord) -> list[str]:
    if not path.exists():
        return [f"{path} is missing"]
    damages = (
        []
        if file_sha256(path) == record.sha256
        else [f"{path}: its sha256 is not that of the manifest"]
    )
    try:
        with opened_shard(path) as file:
            return damages + [f"{path}: {damage}" for damage in _contents(file, record)]
    except DatasetError as error:
        return [*damages, str(error)]


def _contents(file: h5py.File, record: ShardRecord) -> list[str]:
    """Damages within a shard: names, kinds, shapes, lengths, values."""
    damages = [
        f"'{name}' is missing"
        for name in (*PER_TICK, *PER_FRAME, "terrain", "ticks", "frames")
        if name not in file and name not in SOMETIMES
    ]
    if damages:
        return damages
    lengths = {"episodes": len(file["terrain"]), "ticks": int(file["ticks"][:].sum())}
    lengths["frames"] = int(file["frames"][:].sum())
    for name, length in lengths.items():
        if length != getattr(record, name):
            damages.append(f"{length} {name}, the manifest says {getattr(record, name)}")
    for name, kind in _there(file).items():
        array, length = file[name], lengths["ticks" if name in PER_TICK else "frames"]
        if array.dtype != kind or array.ndim != _DIMENSIONS[name] or len(array) != length:
            damages.append(
                f"'{name}' is {array.dtype} of shape {array.shape}, not {np.dtype(kind)} of length "
                f"{length}"
            )
        elif not np.isfinite(array[:]).all():
            damages.append(f"'{name}' is not finite everywhere")
    return damages or _order(file)


def _there(file: h5py.File) -> dict[str, DTypeLike]:
    """Kinds of the columns that a shard has."""
    return {name: kind for name, kind in _KINDS.items() if name in file or name not in SOMETIMES}


def _order(file: h5py.File) -> list[str]:
    """Images belong to ticks of their episode, in order."""
    ticks, frames = file["ticks"][:], file["frames"][:]
    for i, taken in enumerate(np.split(file["frame_tick"][:], np.cumsum(frames)[:-1])):
        if len(taken) and (taken[0] < 0 or taken[-1] >= ticks[i] or (np.diff(taken) <= 0).any()):
            return [f"the images of episode {i} are not in order within its {ticks[i]} ticks"]
    return []


def _compare(shards: Sequence[Path]) -> None:
    """Refuses shards whose arrays do not mean the same.

    Older ones keep no layout, of those the shapes are compared.
    """
    known: dict[str, tuple[object, Path]] = {}
    for path in shards:
        with opened_shard(path) as file:
            fields: dict[str, object] = {
                f"columns of {name}": list(file[name].shape[1:]) for name in _there(file)
            }
            fields |= json.loads(file.attrs.get(LAYOUT, "{}"))
        for name, value in fields.items():
            before, where = known.setdefault(name, (value, path))
            if before != value:
                raise DatasetError(
                    f"{path} and {where} do not fit together: '{name}' is {value} and {before}"
                )
