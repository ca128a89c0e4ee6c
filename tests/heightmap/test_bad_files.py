"""Whatever is given to a command of the heightmap:
one line with exit code 2, nothing written, nothing lost.
"""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_run import glide, record
from samples import ROBOT, put_robot
from synthetic_motion import gliding_episodes

from saltus.cli.main import main
from saltus.config import TerrainConfig
from saltus.grid import LINE
from saltus.heightmap.data.shards import write_shard
from saltus.heightmap.evaluation.geometric import GeometricHeightmap
from saltus.heightmap.service import model_inbox as heightmap_model_inbox
from saltus.heightmap.service.replay import replay_predictor
from saltus.resources import shipped_file
from saltus.runtime.run_folder import SETUP_FILE

JUNK = np.random.default_rng(0).bytes(3000)
BROKEN: dict[str, bytes | None] = {"missing": None, "empty": b"", "junk": JUNK, "text": b"hello\n"}
"""Contents of files that are not what they are given as."""
MANIFESTS: dict[str, bytes] = {
    "empty": b"",
    "junk": JUNK,
    "list": b"[]",
    "text": b'"x"',
    "no shards": b'{"format": "saltus-heightmap-dataset-1", "shards": null}',
    "another format": b'{"format": "saltus-heightmap-dataset-0", "shards": []}',
    "a shard without fields": b'{"format": "saltus-heightmap-dataset-1", "shards": [{"file": '
    b'"a.h5"}]}',
}


def refused(arguments: list[Any], capsys: pytest.CaptureFixture[str], *names: Any) -> None:
    """The command ends with 2 and one line, which names what is wrong."""
    assert main([str(argument) for argument in arguments]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1
    assert told.err.startswith("saltus: ")
    for name in names:
        assert str(name) in told.err


def broken(folder: Path, kind: str, suffix: str) -> Path:
    path, content = folder / f"{kind}{suffix}", BROKEN[kind]
    if content is not None:
        path.write_bytes(content)
    return path


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("data")
    write_shard(path, gliding_episodes(10, ticks=80), seed=0, config={})
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = glide(TerrainConfig(terrain="step", height_m=0.1), steps=40)
    maps = replay_predictor(GeometricHeightmap(ROBOT, LINE), run.frames, run.states, run.arrival_ns)
    return record(tmp_path_factory.mktemp("run") / "recording.mcap", run, maps).path


@pytest.mark.sample(2)
@pytest.mark.parametrize("kind", BROKEN)
def test_checkpoints_models_and_recordings_that_are_none(
    kind: str, data: Path, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    checkpoint, model, run, bag = (
        broken(tmp_path, kind, suffix) for suffix in (".pt", ".onnx", ".mcap", ".bag")
    )
    run_dir = tmp_path / "a run"
    run_dir.mkdir()
    put_robot(run_dir)
    before, out = sorted(tmp_path.iterdir()), tmp_path / "out"
    for path, arguments in (
        (checkpoint, ["train", "--data", data, "--start", checkpoint, "--out", out]),
        (checkpoint, ["dagger", "--start", checkpoint, "--out", out]),
        (checkpoint, ["export", "--data", data, "--checkpoint", checkpoint, "--out", out]),
        (
            checkpoint,
            ["collect", "gpu", "--device", "cpu", "--predictor", checkpoint, "--out", out],
        ),
        (model, ["give", model, "--run-dir", run_dir]),
        (model, ["collect", "cpu", "--model", model, "--out", out]),
        (model, ["eval", "--runs", "1", "--heightmap-model", model]),
        (model, ["report", recording, "--model", model, "--out", out]),
        (run, ["report", run, "--out", out]),
        (bag, ["serve", "--recording", bag, "--assume-level"]),
    ):
        refused(["heightmap", *arguments], capsys, path)
    for arguments in (
        ["replay", run],
        ["replay", bag, "--assume-level"],
        ["replay", recording, "--model", model],
    ):
        refused(arguments, capsys, tmp_path)
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("kind", MANIFESTS)
def test_datasets_that_are_none(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad, out = tmp_path / "bad", tmp_path / "out"
    bad.mkdir()
    (bad / "manifest.json").write_bytes(MANIFESTS[kind])
    shipped = shipped_file("models/heightmap.onnx")
    for arguments in (
        ["train", "--data", bad, "--out", out],
        ["dagger", "--base", bad, "--out", out],
        ["export", "--data", bad, "--checkpoint", shipped, "--out", out],
        ["collect", "cpu", "--batches", "1", "--out", bad],
        ["dataset", "info", bad],
        ["dataset", "validate", bad],
        ["dataset", "merge", bad, "--out", out],
    ):
        refused(["heightmap", *arguments], capsys, bad / "manifest.json")
    assert [path.name for path in tmp_path.rglob("*")] == ["bad", "manifest.json"]


def test_a_manifest_that_names_files_elsewhere(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = json.loads((data / "manifest.json").read_text())
    table["shards"][0]["file"] = "../round_000.h5"
    (tmp_path / "manifest.json").write_text(json.dumps(table))
    refused(["heightmap", "dataset", "info", tmp_path], capsys, "../round_000.h5")


@pytest.mark.parametrize("out", ["/dev/null/x", "a file", "a file/below"])
def test_places_that_cannot_be_written(
    out: str, data: Path, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a file").write_text("kept")
    place = tmp_path / out
    for arguments in (
        ["train", "--data", data, "--out", place],
        ["dagger", "--out", place],
        ["dataset", "merge", data, "--out", place],
        ["report", recording, "--out", place],
        ["give", shipped_file("models/heightmap.onnx"), "--run-dir", place],
    ):
        refused(["heightmap", *arguments], capsys, place)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a file", "kept")]


def test_a_full_disk(
    data: Path, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is written goes to a device without room; what was there before is still there."""
    run, out = tmp_path / "run", tmp_path / "out"
    for folder, unfinished, whole in (
        (run, ".heightmap.onnx.partial", "heightmap.onnx"),
        (run, ".report.html.partial", "report.html"),
        (out, ".round_000.h5.partial", "notes.txt"),
    ):
        folder.mkdir(exist_ok=True)
        (folder / unfinished).symlink_to("/dev/full")
        (folder / whole).write_text("kept")
    model = shipped_file("models/heightmap.onnx")
    refused(["heightmap", "give", model, "--run-dir", put_robot(run)], capsys, run, "No space left")
    (run / SETUP_FILE).unlink()
    refused(["heightmap", "report", recording, "--out", run], capsys, run, "No space left")
    refused(["heightmap", "dataset", "merge", data, "--out", out], capsys, out, "No space left")
    assert {
        path.name: path.read_text() for path in (*run.iterdir(), *out.iterdir())
    } == dict.fromkeys(("heightmap.onnx", "report.html", "notes.txt"), "kept")


def test_folders_without_a_service(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(heightmap_model_inbox, "HEARD_S", 0.2)
    shipped = shipped_file("models/heightmap.onnx")
    for name in (shipped.name, f"{shipped.name}.sha256"):
        shutil.copy(shipped.with_name(name), tmp_path)
    before = {path: path.stat().st_ino for path in tmp_path.iterdir()}
    (tmp_path / "run").mkdir()
    give = ["heightmap", "give", str(tmp_path / shipped.name), "--run-dir", str(tmp_path / "run")]
    refused(give, capsys, "no setup.toml")
    robot = put_robot(tmp_path / "run") / SETUP_FILE
    assert main(give) == 2
    assert "no heightmap service looks into" in capsys.readouterr().err
    assert list((tmp_path / "run").iterdir()) == [robot]
    assert {path: path.stat().st_ino for path in tmp_path.iterdir() if path.is_file()} == before
