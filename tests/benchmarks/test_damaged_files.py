"""Files and messages that chance has damaged:
each is read or refused in one line, and nothing dies, hangs or grows.
"""

import os
import time
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

from benchmarks import _damage
from benchmarks.damaged_files import Benchmark, outcome_of
from saltus import files
from saltus.config import RunConfig, from_toml
from saltus.errors import ConfigError, SaltusError
from saltus.files import check_archive
from saltus.heightmap.data.inventory import validate_dataset
from saltus.wire.topics import TOPICS

pytestmark = pytest.mark.slow

FILES, PAYLOADS = 10, 300


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("samples")
    _damage.make_samples(folder, _damage.shipped())
    return folder


def test_damaged_files_are_read_or_refused_and_models_with_checksums_refused(folder: Path) -> None:
    for kind, sample in _damage.samples(folder, _damage.shipped()).items():
        good = sample.path.read_bytes()
        assert outcome_of(sample)[0] == "read", kind
        for seed in range(FILES):
            sample.path.write_bytes(_damage.damage(good, np.random.default_rng(seed)))
            start_s = time.process_time()
            outcome, text = outcome_of(sample)
            assert outcome in ("read", "refused"), (kind, seed, text)
            assert outcome == "refused" or kind not in ("model heightmap", "model policy")
            assert time.process_time() - start_s < 5.0, (kind, seed)
        sample.path.write_bytes(good)


def test_mutated_messages_of_every_topic_are_read_or_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # In a process of many tests it takes half a second to free memory before it is measured, twice
    # for each topic
    monkeypatch.setattr("benchmarks.damaged_files._settled_mb", lambda: 0.0)
    found = Benchmark(payloads=PAYLOADS).messages(folder / "run" / "recording.mcap")
    assert set(found) == set(TOPICS)
    for topic, row in found.items():
        assert row["raised"] == 0, topic
        assert row["refused"] > 0.4 * PAYLOADS, topic


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 100_000,
        "seed = " + "9" * 5000,
        "speed = " + "9" * 400,
        "a" + ".a" * 50_000 + " = 1",
        "terrain = {" + "a = {" * 5000,
        "\t\0",
        "seed = 1e999",
    ],
    ids=lambda text: text[:12],
)
def test_tables_made_to_hurt_are_refused_in_one_line(text: str) -> None:
    with pytest.raises(ConfigError) as refused:
        from_toml(RunConfig, text)
    assert "\n" not in str(refused.value)


def test_a_dataset_reads_nothing_outside_of_its_shard(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(bytes(2 * 600 * 600))
    for kind in ("link", "soft", "raw", "virtual", "huge"):
        folder = tmp_path / kind
        _damage.make_dataset(folder)
        with h5py.File(folder / "round_000.h5", "r+") as file:
            shape = file["height"].shape
            del file["height"]
            if kind == "link":
                file["height"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "height")
            elif kind == "soft":
                file["height"] = h5py.SoftLink("/depth")
            elif kind == "raw":
                file.create_dataset(
                    "height", shape, np.float32, external=[(str(secret), 0, h5py.h5f.UNLIMITED)]
                )
            elif kind == "virtual":
                layout = h5py.VirtualLayout(shape, np.float32)
                layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "height", shape)
                file.create_virtual_dataset("height", layout)
            else:
                file.create_dataset(
                    "height", (2**40, 30), np.float32, chunks=(256, 30), compression="gzip"
                )
        with pytest.raises(SaltusError, match="'height'"):
            _damage.read_shard(folder / "round_000.h5")
        assert "'height'" in " ".join(validate_dataset(folder))


def test_archives_that_unpack_to_too_much_or_are_damaged_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "archive.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as file:
        file.writestr("data", os.urandom(1000))
    check_archive(path, checksums=True)
    data = path.read_bytes()
    path.write_bytes(data[:500] + bytes([data[500] ^ 1]) + data[501:])
    with pytest.raises(ValueError, match="'data' in it is damaged"):
        check_archive(path, checksums=True)
    monkeypatch.setattr(files, "ARCHIVE_MAX", 999)
    with pytest.raises(ValueError, match="unpacks to 1000 bytes"):
        check_archive(path)
