import copy
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from samples import ROBOT
from small_training import CONFIG, quick
from synthetic_motion import gliding_episodes

from saltus.cli.main import main as saltus
from saltus.errors import ModelError, SaltusError
from saltus.heightmap.data.delivery import TRAINING
from saltus.heightmap.data.shards import DatasetError, dataset_hash, read_manifest, write_shard
from saltus.heightmap.model import HeightmapModel
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.settings import PredictorTraining
from saltus.heightmap.training import release as heightmap_release
from saltus.heightmap.training import train as heightmap_train
from saltus.heightmap.training.dataset import EpisodeStore, ImageNoise, run_window
from saltus.heightmap.training.release import ModelRelease, release_model
from saltus.heightmap.training.train import TrainingProgress, load_checkpoint, train_heightmap
from saltus.heightmap.training.validate import SETTLED_TICKS
from saltus.resources import shipped_file

pytestmark = pytest.mark.usefixtures("short_calibration")


ONE = PredictorTraining(**{**vars(CONFIG), "updates": 1})
SOME = PredictorTraining(**{**vars(CONFIG), "updates": 8})


@pytest.fixture(scope="module")
def begun(data: Path, tmp_path_factory: pytest.TempPathFactory, short_calibration: None) -> Path:
    """Checkpoint of a training of one update."""
    path = tmp_path_factory.mktemp("begun") / "a.pt"
    train_heightmap(data, path, ONE)
    return path


@pytest.fixture(scope="module")
def told() -> list[TrainingProgress]:
    """What the whole training says of itself."""
    return []


@pytest.fixture(scope="module")
def trained(
    data: Path,
    told: list[TrainingProgress],
    tmp_path_factory: pytest.TempPathFactory,
    short_calibration: None,
) -> Path:
    """Checkpoint of a whole training, small as it is."""
    path = tmp_path_factory.mktemp("trained") / "a.pt"
    train_heightmap(data, path, CONFIG, told.append)
    return path


@pytest.fixture(scope="module")
def released(
    data: Path, begun: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[ModelRelease, Path]:
    """What the release of the training of one update measured,
    and its folder, which tests leave as it is.
    """
    folder = tmp_path_factory.mktemp("released")
    return release_model(begun, data, folder / "m.onnx"), folder


def test_training_lowers_the_error_and_the_release_measures_it(
    data: Path,
    released: tuple[ModelRelease, Path],
    trained: Path,
    told: list[TrainingProgress],
    tmp_path: Path,
) -> None:
    assert told[-1].update == CONFIG.updates
    before, _ = released
    after = release_model(trained, data, tmp_path / "b.onnx")
    assert after.clean.mae_m < before.clean.mae_m
    assert after.parity < 1e-5
    assert after.model_id == HeightmapNetwork(ROBOT, tmp_path / "b.onnx").model_id
    assert after.model_id in (tmp_path / "b.md").read_text()


def test_a_model_is_measured_on_what_it_was_not_trained_on(
    data: Path, begun: Path, tmp_path: Path
) -> None:
    manifest, unseen = tmp_path / "elsewhere", tmp_path / "unseen"
    manifest.mkdir()
    shutil.copy(data / "manifest.json", manifest)  # the shards stayed on the machine that trained
    write_shard(unseen, gliding_episodes(3, seed=1), seed=1, config={"source": "synthetic"})
    result = release_model(begun, manifest, tmp_path / "a.onnx", unseen)
    assert result.clean.ticks == 3 * (150 - SETTLED_TICKS)
    assert read_manifest(data)[0].sha256[:16] in (tmp_path / "a.md").read_text()
    with pytest.raises(DatasetError, match="was trained on"):
        release_model(begun, data, tmp_path / "b.onnx", data)
    with pytest.raises(DatasetError, match="not on"):
        release_model(begun, unseen, tmp_path / "b.onnx")
    assert not (tmp_path / "b.onnx").exists()


def test_what_the_start_of_a_training_saw_and_twins_of_it_are_not_unseen(
    data: Path, begun: Path, tmp_path: Path
) -> None:
    further, twin = tmp_path / "further", tmp_path / "twin"
    write_shard(
        further,
        gliding_episodes(10, seed=2),
        seed=2,
        config={"source": "synthetic", "camera": "ideal"},
    )
    write_shard(
        twin,
        gliding_episodes(11, seed=2),
        seed=2,
        config={"source": "synthetic", "camera": "d435i"},
    )
    train_heightmap(further, tmp_path / "b.pt", ONE, start=begun)
    for known in (data, twin):
        with pytest.raises(DatasetError, match="was trained on"):
            release_model(tmp_path / "b.pt", further, tmp_path / "b.onnx", known)


def test_the_command_measures_on_unseen_data_and_says_so(
    data: Path, begun: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_shard(
        tmp_path / "unseen", gliding_episodes(3, seed=77), seed=77, config={"source": "synthetic"}
    )
    out = tmp_path / "new folder" / "heightmap.onnx"
    files = ["--checkpoint", str(begun), "--out", str(out.parent)]
    command = ["heightmap", "export", "--data", str(data), *files]
    assert saltus([*command, "--unseen", str(tmp_path / "unseen")]) == 0
    assert HeightmapNetwork(ROBOT, out).model_id in capsys.readouterr().out
    card = out.with_suffix(".md").read_text()
    assert f"3 of dataset {dataset_hash(read_manifest(tmp_path / 'unseen'))}, seeds 77" in card
    assert {path.name for path in out.parent.iterdir()} == {
        "heightmap.onnx", "heightmap.onnx.sha256", "heightmap.md",
    }  # fmt: skip


@pytest.mark.parametrize("step", ["warmup_frames", "parity", "height_accuracy"])
def test_an_export_that_ends_early_leaves_the_model_that_was_there(
    data: Path,
    released: tuple[ModelRelease, Path],
    trained: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    step: str,
) -> None:
    folder = tmp_path / "models"
    shutil.copytree(released[1], folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    def interrupted(*_: Any) -> float:
        raise KeyboardInterrupt

    monkeypatch.setattr(heightmap_release, step, interrupted)
    with pytest.raises(KeyboardInterrupt):
        release_model(trained, data, folder / "m.onnx")
    monkeypatch.setattr(heightmap_release, step, lambda *_: math.nan)
    if step == "parity":
        with pytest.raises(ModelError, match="differs"):
            release_model(trained, data, folder / "m.onnx")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.slow
def test_a_moment_of_further_training_from_the_shipped_network_is_exported(
    data: Path, tmp_path: Path
) -> None:
    config = PredictorTraining(updates=3, batch=4, window=30, device="cpu")
    train_heightmap(data, tmp_path / "a.pt", config, start=shipped_file("models/heightmap.onnx"))
    assert release_model(tmp_path / "a.pt", data, tmp_path / "a.onnx").parity < 1e-5


def _gates_swapped(model: HeightmapModel) -> None:
    for weights in model.gru.parameters():
        reset, update, new = weights.data.clone().chunk(3)
        weights.data = torch.cat((update, reset, new))


def _weight_changed(model: HeightmapModel) -> None:
    model.gru.weight_hh_l0.data[3, 5] += 0.01


def _scaled(model: HeightmapModel) -> None:
    model.proprioception_std *= 1.001


@pytest.mark.parametrize("damage", [_gates_swapped, _weight_changed, _scaled])
def test_a_file_of_another_network_is_refused(
    data: Path,
    trained: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    damage: Callable[[HeightmapModel], None],
) -> None:
    law = heightmap_release.export_heightmap

    def wrong(model: HeightmapModel, *rest: Any) -> None:
        other = copy.deepcopy(model)
        damage(other)
        law(other, *rest)

    monkeypatch.setattr(heightmap_release, "export_heightmap", wrong)
    with pytest.raises(ModelError, match="differs"):
        release_model(trained, data, tmp_path / "a.onnx")
    assert not (tmp_path / "a.onnx").exists()


def test_an_interrupted_training_goes_on(data: Path, tmp_path: Path) -> None:
    config = PredictorTraining(**{**vars(SOME), "save_every_s": 0.0})

    def interrupt(progress: TrainingProgress) -> None:
        raise KeyboardInterrupt

    checkpoint = tmp_path / "c.pt"
    train_heightmap(data, checkpoint, config)
    assert load_checkpoint(checkpoint)[1]["update"] == config.updates
    before = checkpoint.read_bytes()
    model = train_heightmap(data, checkpoint, config, interrupt)
    assert checkpoint.read_bytes() == before
    loaded, _ = load_checkpoint(checkpoint)
    for a, b in zip(model.parameters(), loaded.parameters(), strict=True):
        torch.testing.assert_close(a, b)


@pytest.mark.sample(1)
@pytest.mark.parametrize("where", ["run_window", "calibrate_intervals"])
def test_what_was_learned_before_an_interruption_is_kept(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    checkpoint, calls = tmp_path / "c.pt", []
    config = PredictorTraining(**{**vars(SOME), "save_every_s": math.inf})
    interrupted_at = {"run_window": 5, "calibrate_intervals": 1}[where]
    law = getattr(heightmap_train, where)

    def interrupted(*given: Any) -> Any:
        calls.append(where)
        if len(calls) == interrupted_at:
            raise KeyboardInterrupt
        return law(*given)

    monkeypatch.setattr(heightmap_train, where, interrupted)
    with pytest.raises(KeyboardInterrupt):
        train_heightmap(data, checkpoint, config)
    assert [path.name for path in tmp_path.iterdir()] == ["c.pt"]
    # With the last update the calibration is made again.
    assert (
        load_checkpoint(checkpoint)[1]["update"]
        == {"run_window": 4, "calibrate_intervals": config.updates - 1}[where]
    )
    train_heightmap(data, checkpoint, config)
    assert load_checkpoint(checkpoint)[1]["update"] == config.updates
    assert len(calls) == {"run_window": config.updates + 1, "calibrate_intervals": 2}[where]


def test_an_interruption_while_it_is_kept_loses_nothing(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoint, save, calls = tmp_path / "c.pt", torch.save, []

    def interrupted(*given: Any) -> None:
        calls.append(given)
        if len(calls) == 1:
            raise KeyboardInterrupt
        save(*given)

    monkeypatch.setattr(torch, "save", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train_heightmap(
            data, checkpoint, PredictorTraining(**{**vars(CONFIG), "save_every_s": 0.0})
        )
    assert load_checkpoint(checkpoint)[1]["update"] == 1


def test_a_checkpoint_of_another_training_is_left_alone(
    data: Path, begun: Path, trained: Path, tmp_path: Path
) -> None:
    path = tmp_path / "c.pt"
    train_heightmap(data, path, ONE, start=begun)
    before = path.read_bytes()
    for change, start, values in (
        ("updates", begun, {"updates": 3}),
        ("forgets", begun, {"forgets": 0.1}),
        ("start", trained, {}),
    ):
        with pytest.raises(ModelError, match=f"another training .*{change}"):
            train_heightmap(data, path, PredictorTraining(**{**vars(ONE), **values}), start=start)
        assert path.read_bytes() == before


@pytest.mark.parametrize(
    "content",
    ["missing", "text", "words", "empty", "folder", "another table", "another origin", "cut"],
)
def test_what_is_no_checkpoint_is_refused_before_any_work(
    data: Path, begun: Path, tmp_path: Path, content: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path, whole = tmp_path / "a.pt", begun.read_bytes()
    if content == "folder":
        path.mkdir()
    elif content == "another table":
        torch.save({"model": {}}, path)
    elif content == "another origin":
        torch.save({"model": {}, "origin": {}, "update": 1, "optimiser": {}}, path)
    elif content != "missing":
        path.write_bytes(
            {
                "text": b"not a checkpoint\n",
                "words": b"hello\n",
                "empty": b"",
                "cut": whole[: len(whole) // 2],
            }[content]
        )
    given = [
        "heightmap",
        "train",
        "--data",
        str(data),
        "--out",
        str(tmp_path / "b"),
        "--updates",
        "1",
    ]
    for command in (
        [*given, "--start", str(path)],
        [
            "heightmap",
            "export",
            "--data",
            str(data),
            "--checkpoint",
            str(path),
            "--out",
            str(tmp_path / "m"),
        ],
        ["heightmap", "dagger", "--start", str(path), "--out", str(tmp_path / "run")],
    ):
        assert saltus(command) == 2
        last = capsys.readouterr().err.splitlines()[-1]
        assert last.startswith("saltus: ")
        assert str(path) in last
    assert {item.name for item in tmp_path.iterdir()} <= {"a.pt"}


def test_a_checkpoint_that_cannot_be_written_is_said_before_any_work(
    data: Path, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("no folder")
    told: list[TrainingProgress] = []
    with pytest.raises(SaltusError, match="folder"):
        train_heightmap(data, tmp_path / "file" / "a.pt", CONFIG, told.append)
    assert not told


def test_a_training_forgets_as_often_as_it_is_told(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shares: list[float] = []
    windows = EpisodeStore.windows

    def watched(*given: Any, forgets: float) -> Any:
        shares.append(forgets)
        return windows(*given, forgets=forgets)

    monkeypatch.setattr(EpisodeStore, "windows", watched)
    monkeypatch.setattr(heightmap_train, "calibrate_intervals", lambda *_: None)
    assert saltus([*quick(data, tmp_path / "g"), "--forgets", "0.25"]) == 0
    assert saltus(quick(data, tmp_path / "h")) == 0
    assert shares == [0.25, PredictorTraining().forgets]


def test_a_window_that_starts_knows_nothing_of_what_was_before(
    store: EpisodeStore, model: HeightmapModel
) -> None:
    window = next(store.windows(4, 20, TRAINING, ImageNoise(), np.random.default_rng(0)))
    window = window._replace(starts=torch.tensor([True, False, True, False]))
    rng = torch.Generator().manual_seed(0)
    states = [torch.rand((4, model.config.hidden), generator=rng) for _ in range(2)]
    with torch.no_grad():
        (first, _), (second, _) = (run_window(model, window, state) for state in states)
    same = (first.height == second.height).all(-1).all(0)
    assert same.tolist() == window.starts.tolist()


def test_a_further_round_begins_with_what_was_learned(
    data: Path, trained: Path, tmp_path: Path
) -> None:
    told: list[TrainingProgress] = []
    further = PredictorTraining(**{**vars(ONE), "learning_rate": 0.0, "seed": 5})
    model = train_heightmap(data, tmp_path / "e.pt", further, told.append, start=trained)
    before = load_checkpoint(trained)[0].state_dict()
    for name, weights in model.state_dict().items():
        if name != "correction":  # of intervals: it is fitted anew
            torch.testing.assert_close(weights, before[name])
