from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.inventory import validate_dataset
from saltus.heightmap.data.shard_columns import CHUNK, ShardColumn, read_column
from saltus.heightmap.data.shards import (
    DatasetError,
    dataset_hash,
    read_dataset,
    read_manifest,
    write_shard,
)


def episodes(count: int, seed: int, *, plans: bool = False) -> Iterator[Episode]:
    rng = np.random.default_rng(seed)
    for i in range(count):
        ticks = int(rng.integers(20, 60))
        yield Episode(
            terrain=["flat", "stepping_stones"][i % 2],
            proprioception=rng.normal(size=(ticks, 21)).astype(np.float32),
            height=rng.normal(size=(ticks, 30)).astype(np.float32),
            depth=rng.integers(0, 65536, (ticks // 2, 48, 16)).astype(np.uint16),
            frame_tick=np.arange(0, 2 * (ticks // 2), 2, dtype=np.int32),
            state=rng.normal(size=(ticks, 29)).astype(np.float32) if plans else None,
            plan=rng.normal(size=(ticks, 10)).astype(np.float32) if plans else None,
        )


def same(left: Episode, right: Episode) -> bool:
    arrays = ("proprioception", "height", "depth", "frame_tick", "state", "plan")
    return left.terrain == right.terrain and all(
        np.array_equal(getattr(left, name), getattr(right, name)) for name in arrays
    )


def test_rounds_add_up_and_come_back(tmp_path: Path) -> None:
    for seed in range(3):
        write_shard(
            tmp_path, episodes(4, seed, plans=seed == 1), seed=seed, config={"source": "test"}
        )
    written = [e for seed in range(3) for e in episodes(4, seed, plans=seed == 1)]
    back = read_dataset(tmp_path)
    assert len(back) == len(written)
    assert all(same(a, b) for a, b in zip(back, written, strict=True))
    records = read_manifest(tmp_path)
    assert [r.seed for r in records] == [0, 1, 2]
    assert sum(r.ticks for r in records) == sum(len(e.height) for e in written)
    assert validate_dataset(tmp_path) == []


@pytest.mark.parametrize(
    "change", [{}, {"episodes": 9}, {"batches": 2}, {"camera": "ideal"}, {"cameras": ("ideal",)}]
)
def test_episodes_do_not_come_twice(tmp_path: Path, change: dict[str, Any]) -> None:
    config = {
        "source": "test",
        "episodes": 4,
        "batches": 1,
        "camera": "d435i",
        "cameras": ("d435i",),
    }
    write_shard(tmp_path, episodes(4, 0), seed=0, config=config)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(DatasetError, match=r"round_000\.h5 holds the episodes of seed 0"):
        write_shard(tmp_path, episodes(4, 0), seed=0, config={**config, **change})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    write_shard(tmp_path, episodes(4, 0), seed=0, config={**config, "source": "other"})
    write_shard(tmp_path, episodes(4, 1), seed=1, config=config)
    assert len(read_manifest(tmp_path)) == 3
    assert [
        damage
        for damage in validate_dataset(tmp_path)
        if "round_001.h5 holds the episodes of round_000.h5" in damage
    ]


@pytest.mark.parametrize("after", range(4))
def test_an_interrupted_round_leaves_nothing(tmp_path: Path, after: int) -> None:
    write_shard(tmp_path, episodes(2, 0), seed=0, config={})
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def interrupted() -> Iterator[Episode]:
        yield from list(episodes(3, 1))[:after]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_shard(tmp_path, interrupted(), seed=1, config={})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_changed_or_missing_shard_is_refused(tmp_path: Path) -> None:
    record = write_shard(tmp_path, episodes(2, 0), seed=0, config={})
    path = tmp_path / record.file
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(DatasetError, match="sha256 differs"):
        read_dataset(tmp_path)
    path.unlink()
    with pytest.raises(DatasetError, match="is missing"):
        read_dataset(tmp_path)


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"format": "other", "shards": []}', '{"format"'])
def test_a_damaged_manifest_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(DatasetError, match=r"manifest\.json"):
        read_dataset(tmp_path)


def test_the_hash_of_a_dataset_names_its_content(tmp_path: Path) -> None:
    write_shard(tmp_path / "a", episodes(2, 0), seed=0, config={})
    write_shard(tmp_path / "b", episodes(2, 1), seed=0, config={})
    assert dataset_hash(read_manifest(tmp_path / "a")) != dataset_hash(
        read_manifest(tmp_path / "b")
    )


def test_no_episodes_are_an_error(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no episodes"):
        write_shard(tmp_path, iter(()), seed=0, config={})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("rows", [1, 255, 256, 257, 40_000])
@pytest.mark.parametrize("kind", ["plain", "noise"])
def test_columns_are_what_hdf5_itself_reads_and_writes(
    tmp_path: Path, rows: int, kind: str
) -> None:
    """Noise gets longer by compression: HDF5 then leaves a chunk as it is."""
    rng = np.random.default_rng(rows)
    given = np.arange(3 * rows, dtype=np.uint32).reshape(-1, 3)
    if kind == "noise":
        given = rng.integers(0, 2**32, given.shape, dtype=np.uint32)
    with ThreadPoolExecutor(2) as pool, h5py.File(tmp_path / "columns.h5", "w") as file:
        ours = ShardColumn(file, "ours", given, pool)
        for part in np.array_split(given, 7):
            ours.append(part)
        ours.close()
        file.create_dataset(
            "theirs",
            data=given,
            maxshape=(None, 3),
            chunks=(CHUNK, 3),
            compression="gzip",
            shuffle=True,
        )
        file.create_dataset("fast", data=given, chunks=True, compression="lzf")
        np.testing.assert_array_equal(file["ours"][:], given)
        for name in file:
            np.testing.assert_array_equal(read_column(file[name], pool), given)
