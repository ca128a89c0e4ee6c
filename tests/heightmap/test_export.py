"""A dataset in Parquet, for LeRobot, described in Croissant:
what is read back is what was written.
"""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from saltus.cli.main import main
from saltus.grid import LINE
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.export import (
    CROISSANT_FILE,
    EPISODES_FILE,
    INFO_FILE,
    STATS_FILE,
    TASKS_FILE,
)
from saltus.heightmap.data.export_columns import NO_IMAGE_S, columns_of
from saltus.heightmap.data.shards import write_shard
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION

LENGTHS = (7, 30, 12)
TERRAINS = ("stairs", "gap", "stairs")


def episode(terrain: str, ticks: int, seed: int) -> Episode:
    """Its first image comes at tick 1."""
    rng = np.random.default_rng(seed)
    taken = np.arange(1, ticks, 2, dtype=np.int32)
    return Episode(
        terrain=terrain,
        proprioception=rng.normal(size=(ticks, len(PROPRIOCEPTION))).astype(np.float32),
        height=rng.normal(size=(ticks, 30)).astype(np.float32),
        depth=rng.integers(0, 65536, (len(taken), 48, 16)).astype(np.uint16),
        frame_tick=taken,
    )


EPISODES = [
    episode(terrain, ticks, i)
    for i, (terrain, ticks) in enumerate(zip(TERRAINS, LENGTHS, strict=True))
]


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a dataset of two shards."""
    place = tmp_path_factory.mktemp("export")
    write_shard(place / "data", EPISODES[:2], seed=0, config={})
    write_shard(place / "data", EPISODES[2:], seed=1, config={})
    assert (
        main(["heightmap", "dataset", "export", str(place / "data"), "--out", str(place / "out")])
        == 0
    )
    return place / "out"


def test_rows_are_the_ticks_with_the_newest_image_of_each(exported: Path) -> None:
    files = sorted(exported.glob("data/*/*.parquet"))
    assert len(files) == 2
    rows = [row for file in files for row in pq.read_table(file).to_pylist()]
    assert [row["index"] for row in rows] == list(range(sum(LENGTHS)))
    for number, known in enumerate(EPISODES):
        own = [row for row in rows if row["episode_index"] == number]
        assert [row["frame_index"] for row in own] == list(range(LENGTHS[number]))
        np.testing.assert_array_equal(
            [row["observation.state"] for row in own], known.proprioception
        )
        np.testing.assert_array_equal([row["label.height"] for row in own], known.height)
        np.testing.assert_allclose(
            [row["timestamp"] for row in own], 0.01 * np.arange(len(own)), rtol=1e-6
        )
        for tick, row in enumerate(own):
            image = (tick + 1) // 2 - 1  # taken at ticks 1, 3, 5, ...
            depth = np.array(row["observation.depth"])
            np.testing.assert_array_equal(
                depth, known.depth[image] if image >= 0 else np.zeros((48, 16))
            )
            age_s = 0.01 * (tick - known.frame_tick[image]) if image >= 0 else NO_IMAGE_S
            assert row["observation.depth_age"] == pytest.approx(age_s)


def test_meta_says_what_lerobot_asks_for(exported: Path) -> None:
    info = json.loads((exported / INFO_FILE).read_text())
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (3, sum(LENGTHS), 100)
    assert (
        set(info["features"])
        == {column.name for column in columns_of(LINE)}
        == set(json.loads((exported / STATS_FILE).read_text()))
    )
    episodes = pq.read_table(exported / EPISODES_FILE).to_pylist()
    ends = np.cumsum(LENGTHS).tolist()
    assert [row["dataset_to_index"] for row in episodes] == ends
    assert [row["dataset_from_index"] for row in episodes] == [0, *ends[:-1]]
    assert [row["data/file_index"] for row in episodes] == [0, 0, 1]
    for row in episodes:
        file = info["data_path"].format(
            chunk_index=row["data/chunk_index"], file_index=row["data/file_index"]
        )
        assert row["episode_index"] in pq.read_table(exported / file)["episode_index"].to_pylist()
    tasks = dict(
        zip(
            *(
                pq.read_table(exported / TASKS_FILE)[name].to_pylist()
                for name in ("__index_level_0__", "task_index")
            ),
            strict=True,
        )
    )
    assert tasks == {"stairs": 0, "gap": 1}
    assert [row["tasks"] for row in episodes] == [[terrain] for terrain in TERRAINS]


def test_statistics_are_those_of_the_rows(exported: Path) -> None:
    stats = json.loads((exported / STATS_FILE).read_text())
    heights = np.concatenate([known.height for known in EPISODES]).astype(np.float64)
    for name, value in (
        ("min", heights.min(0)),
        ("max", heights.max(0)),
        ("mean", heights.mean(0)),
        ("std", heights.std(0)),
    ):
        np.testing.assert_allclose(stats["label.height"][name], value, atol=1e-9)
    assert np.shape(stats["observation.depth"]["mean"]) == (48, 16)


def test_croissant_names_each_column_and_the_files_that_are_there(exported: Path) -> None:
    table = json.loads((exported / CROISSANT_FILE).read_text())
    (files,), (records,) = table["distribution"], table["recordSet"]
    assert len(list(exported.glob(files["includes"]))) == 2
    assert [field["source"]["extract"]["column"] for field in records["field"]] == [
        column.name for column in columns_of(LINE)
    ]
    assert {field["source"]["fileSet"]["@id"] for field in records["field"]} == {files["@id"]}


def test_a_folder_that_is_there_is_left_alone(
    exported: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(
            [
                "heightmap",
                "dataset",
                "export",
                str(exported.parent / "data"),
                "--out",
                str(exported),
            ]
        )
        == 2
    )
    assert "already" in capsys.readouterr().err
