import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from test_shards import episodes

from saltus.cli.main import main
from saltus.depth_camera import SHIPPED
from saltus.heightmap.data.inventory import dataset_info, merge_datasets, validate_dataset
from saltus.heightmap.data.shards import (
    LAYOUT,
    DatasetError,
    dataset_hash,
    file_sha256,
    read_dataset,
    read_manifest,
    write_manifest,
    write_shard,
)


def dataset(directory: Path, *seeds: int) -> Path:
    for seed in seeds:
        write_shard(directory, episodes(3, seed), seed=seed, config={"source": "test"})
    return directory


def change(directory: Path, edit: Callable[[h5py.File], None]) -> None:
    """Changes the first shard, and lets the manifest vouch for what comes out."""
    first, *others = read_manifest(directory)
    with h5py.File(directory / first.file, "r+") as file:
        edit(file)
    write_manifest(directory, [replace(first, sha256=file_sha256(directory / first.file)), *others])


def put(name: str, index: int, value: float) -> Callable[[h5py.File], None]:
    def edit(file: h5py.File) -> None:
        file[name][index] = value

    return edit


def remove(name: str) -> Callable[[h5py.File], None]:
    def edit(file: h5py.File) -> None:
        del file[name]

    return edit


def shorten(name: str) -> Callable[[h5py.File], None]:
    def edit(file: h5py.File) -> None:
        file[name].resize(len(file[name]) - 1, axis=0)

    return edit


ARRAYS = ("proprioception", "height", "depth", "frame_tick")
DAMAGES: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    **{
        f"{name} missing": (remove(name), f"'{name}' is missing")
        for name in (*ARRAYS, "terrain", "ticks", "frames")
    },
    **{f"{name} short": (shorten(name), f"'{name}' is") for name in ARRAYS},
    "height nan": (put("height", 7, np.nan), "'height' is not finite"),
    "proprioception inf": (put("proprioception", 3, np.inf), "'proprioception' is not finite"),
    "ticks": (put("ticks", 1, 3), "the manifest says"),
    "order": (put("frame_tick", 2, 1), "images of episode 0 are not in order"),
    "beyond": (put("frame_tick", 1, 4000), "images of episode 0 are not in order"),
}


def test_a_sound_dataset_is_called_sound(tmp_path: Path) -> None:
    assert validate_dataset(dataset(tmp_path, 0, 1)) == []
    assert main(["heightmap", "dataset", "validate", str(tmp_path)]) == 0


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_damaged_is_named(tmp_path: Path, damage: str) -> None:
    edit, words = DAMAGES[damage]
    change(dataset(tmp_path, 0, 1), edit)
    (found, *_) = validate_dataset(tmp_path)
    assert "round_000.h5" in found
    assert words in found
    assert main(["heightmap", "dataset", "validate", str(tmp_path)]) == 1


@pytest.mark.parametrize("where", [0.0, 0.3, 0.6, 0.99])
def test_a_changed_or_truncated_shard_is_named(tmp_path: Path, where: float) -> None:
    shard = dataset(tmp_path, 0, 1) / "round_001.h5"
    sound = shard.read_bytes()
    at = int(where * len(sound))
    for broken in (sound[:at], sound[:at] + bytes([sound[at] ^ 255]) + sound[at + 1 :]):
        shard.write_bytes(broken)
        assert any("round_001.h5" in damage for damage in validate_dataset(tmp_path))
        assert not any("round_000.h5" in damage for damage in validate_dataset(tmp_path))
    shard.unlink()
    assert validate_dataset(tmp_path) == [f"{shard} is missing"]


def test_merging_joins_all_episodes_once(tmp_path: Path) -> None:
    left, right = dataset(tmp_path / "left", 0, 1), dataset(tmp_path / "right", 1, 2)
    merge_datasets([left, right], tmp_path / "out")
    assert [record.seed for record in read_manifest(tmp_path / "out")] == [0, 1, 2]
    assert len(read_dataset(tmp_path / "out")) == 9
    assert validate_dataset(tmp_path / "out") == []
    assert dataset_info(tmp_path / "out").dataset == dataset_hash(
        read_manifest(dataset(tmp_path / "all", 0, 1, 2))
    )
    with pytest.raises(DatasetError, match="already is a dataset"):
        merge_datasets([left], tmp_path / "out")


@pytest.mark.parametrize("field", ["grid_m", "proprioception", "camera", "tick_s"])
def test_datasets_that_mean_different_things_are_not_merged(tmp_path: Path, field: str) -> None:
    def edit(file: h5py.File) -> None:
        table = json.loads(file.attrs[LAYOUT])
        file.attrs[LAYOUT] = json.dumps({**table, field: "other"})

    left, right = dataset(tmp_path / "left", 0), dataset(tmp_path / "right", 1)
    change(right, edit)
    with pytest.raises(DatasetError, match=f"'{field}' is"):
        merge_datasets([left, right], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_older_shards_are_merged_by_their_shapes(tmp_path: Path) -> None:
    left, right = dataset(tmp_path / "left", 0), tmp_path / "right"
    change(left, lambda file: file.attrs.pop(LAYOUT))
    dataset(right, 1)
    assert len(merge_datasets([left, right], tmp_path / "out")) == 2
    narrow = (replace(e, height=e.height[:, :20]) for e in episodes(3, 4))
    write_shard(tmp_path / "narrow", narrow, seed=4, config={})
    with pytest.raises(DatasetError, match="columns of height"):
        merge_datasets([left, tmp_path / "narrow"], tmp_path / "other")


def test_a_damaged_dataset_is_not_merged(tmp_path: Path) -> None:
    shard = dataset(tmp_path / "left", 0) / "round_000.h5"
    shard.write_bytes(shard.read_bytes()[:-10])
    with pytest.raises(DatasetError, match=r"round_000\.h5"):
        merge_datasets([tmp_path / "left"], tmp_path / "out")


def test_no_dataset_is_an_error(tmp_path: Path) -> None:
    for command in ("info", "validate"):
        assert main(["heightmap", "dataset", command, str(tmp_path / "nothing")]) == 2


def test_a_dataset_names_the_camera_of_each_shard(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = replace(SHIPPED["d435i"], name="mine", camera_pitch=0.4)
    cameras = (SHIPPED["ideal"], SHIPPED["d435i"], own, replace(own, camera_pitch=0.5))
    for seed, camera in enumerate(cameras):
        write_shard(
            tmp_path,
            episodes(1, seed),
            seed=seed,
            config={"source": "test", "camera": camera.record},
        )
    named = [f"{camera.name} {camera.fingerprint}" for camera in cameras]
    assert len(set(named)) == len(cameras)
    assert main(["heightmap", "dataset", "info", str(tmp_path)]) == 0
    assert [f"    camera {name}" for name in named] == capsys.readouterr().out.splitlines()[2:-1:3]
    assert main(["heightmap", "dataset", "info", str(tmp_path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert [shard["camera"] for shard in found["shards"]] == named
