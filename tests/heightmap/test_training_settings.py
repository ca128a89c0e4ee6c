"""Settings of a training: by file and by flag, kept when it goes on."""

import math
from pathlib import Path

import pytest
from small_training import CONFIG, quick

from saltus.cli.main import main as saltus
from saltus.errors import ConfigError
from saltus.heightmap.settings import ModelSettings, PredictorTraining
from saltus.heightmap.training.train import load_checkpoint

pytestmark = pytest.mark.usefixtures("short_calibration")


@pytest.mark.parametrize(
    "wrong",
    [{"updates": 0}, {"batch": -2}, {"forgets": -0.1}, {"forgets": 1.5}, {"forgets": math.nan}],
    ids=str,
)
def test_a_training_that_cannot_be_is_refused_by_name(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        PredictorTraining(**{**vars(CONFIG), **wrong})


def test_a_file_changes_what_it_names_a_flag_wins_and_both_are_told(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "some.toml"
    file.write_text('delivery = "at-once"\nbatch = 4\n[model]\nhead = [16]\n')
    assert saltus([*quick(data, tmp_path / "f"), "--no-noise", "--config", str(file)]) == 0
    model, origin = load_checkpoint(tmp_path / "f" / "heightmap.pt")
    config = origin["config"]
    assert (config["noise"], config["delivery"], config["batch"]) == (False, "at-once", 2)
    assert model.config == ModelSettings(hidden=32, head=(16,))
    said = capsys.readouterr().err.splitlines()[0]
    assert said.startswith(
        "settings other than by default: updates = 1 (1500), batch = 2 (32), window = 50 (100), "
    )
    assert "model.head = (16,) ((256, 256))" in said
    assert "forgets" not in said


def test_a_training_goes_on_with_its_own_settings_on_another_device(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert saltus([*quick(data, tmp_path), "--seed", "3", "--forgets", "0.1"]) == 0
    before = (tmp_path / "heightmap.pt").read_bytes()
    again = ["heightmap", "train", "--data", str(data), "--out", str(tmp_path)]
    for more, told in (
        ([], "as of the run that goes on"),
        (["--save-every-s", "5"], "save_every_s = 5.0 (60.0)"),
    ):
        capsys.readouterr()
        assert saltus([*again, *more]) == 0
        assert told in capsys.readouterr().err.splitlines()[0]
    assert saltus([*again, "--forgets", "0.2"]) == 2
    assert (
        "another training (config.forgets = 0.1, not 0.2)"
        in capsys.readouterr().err.splitlines()[-1]
    )
    assert (tmp_path / "heightmap.pt").read_bytes() == before


@pytest.mark.parametrize(
    "text", ["updates = 0", "update = 5", "updates = [", "batch = 'many'", "seed = -1", "\xff"]
)
def test_a_file_that_cannot_be_used_is_refused_by_name(
    tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "some.toml"
    file.write_bytes(text.encode("latin-1"))
    assert saltus([*quick(tmp_path, tmp_path / "f"), "--config", str(file)]) == 2
    assert str(file) in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["some.toml"]
