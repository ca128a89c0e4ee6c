"""The command line of a training: what a file and a flag change,
what is refused, and that nothing is lost.
"""

import re
import signal
import subprocess
import sys
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
import torch
from tensordict import TensorDict

from saltus.cli.main import main
from saltus.cli.policy_train import TrainPolicy, parse
from saltus.config import to_toml
from saltus.errors import SaltusError
from saltus.folders import setting_differences
from saltus.grid import LINE
from saltus.model_file import ModelFile
from saltus.policy.actor import PolicyActor
from saltus.policy.bounds import ActionBounds
from saltus.policy.csv_tables import read_csv_table
from saltus.policy.env.jump_env import JumpEnv
from saltus.policy.env.settings import JumpTrainSettings, LearningSettings, for_cpu
from saltus.policy.policy_features import size_with
from saltus.policy.training.checkpoint import NEEDED, read_policy_checkpoint, training_config
from saltus.policy.training.learner import JumpLearner
from saltus.policy.training.train import make_engine
from saltus.policy.training.training_command import STARTED
from saltus.resources import shipped_file
from saltus.robots.loading import load_robot

TINY = ("--device", "cpu", "--robots", "8", "--learning.hidden", "8", "--learning.horizon", "2")
RESUMED = replace(
    for_cpu("go1", "line"),
    robots=40,
    seed=7,
    learning=LearningSettings(hidden=(16, 8), epochs=2, desired_kl=0.003),
)


def leaves(config: Any, path: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], Any]]:
    """Every value of a configuration with its place."""
    if not is_dataclass(config):
        return [(path, config)]
    return [
        leaf for f in fields(config) for leaf in leaves(getattr(config, f.name), (*path, f.name))
    ]


FAMILY = leaves(JumpTrainSettings(robot="go1", grid="line"))


def other(value: Any) -> Any:
    """Another value that is allowed in its place."""
    if isinstance(value, tuple):
        return tuple(other(item) for item in value) or (1, 3)
    if isinstance(value, str):
        return "ideal"
    if isinstance(value, dict):
        return {"beams": 0.5}
    return value + 1 if isinstance(value, int) else 0.875 * value or 0.001


def at(config: Any, path: tuple[str, ...]) -> Any:
    for name in path:
        config = getattr(config, name)
    return config


def table(path: tuple[str, ...], value: Any) -> dict[str, Any]:
    for name in reversed(path):
        value = {name: list(value) if isinstance(value, tuple) else value}
    return value  # type: ignore[no-any-return]


def changed(before: JumpTrainSettings, now: JumpTrainSettings) -> list[str]:
    return [d.name for d in setting_differences(table_of(before), table_of(now))]


def table_of(config: Any) -> dict[str, Any]:
    return {
        f.name: table_of(v) if is_dataclass(v := getattr(config, f.name)) else v
        for f in fields(config)
    }


@pytest.fixture
def resumed(tmp_path: Path) -> Path:
    """A checkpoint with a configuration that differs from all defaults."""
    path = tmp_path / "resumed.pt"
    torch.save({**dict.fromkeys(NEEDED, 0), "config": to_toml(RESUMED)}, path)
    return path


@pytest.fixture(params=["new", "goes on"])
def begun(request: pytest.FixtureRequest, resumed: Path) -> tuple[JumpTrainSettings, TrainPolicy]:
    """What a training begins with, and its command."""
    goes_on = request.param == "goes on"
    return (RESUMED if goes_on else for_cpu("go1", "line")), TrainPolicy(
        device="cpu", resume=resumed if goes_on else None
    )


each_value = pytest.mark.parametrize("path", [path for path, _ in FAMILY], ids=".".join)


@each_value
def test_a_file_with_one_value_changes_that_value_alone(
    path: tuple[str, ...], begun: tuple[JumpTrainSettings, TrainPolicy], tmp_path: Path
) -> None:
    before, command = begun
    new = other(at(before, path))
    file = tmp_path / "changes.toml"
    file.write_text(tomli_w.dumps(table(path, new)))
    check_changed(before, replace(command, config=file).defaults().training, path, new)


@pytest.mark.sample(12)
@each_value
def test_a_flag_changes_its_value_alone(path: tuple[str, ...], resumed: Path) -> None:
    new = other(at(RESUMED, path))
    items = [word for pair in new.items() for word in pair] if isinstance(new, dict) else new
    words = [str(item) for item in items] if isinstance(items, tuple | list) else [str(items)]
    flag = "--profile" if path[-1] == "profile" else "--" + ".".join(path).replace("_", "-")
    check_changed(
        RESUMED,
        parse(["--device", "cpu", "--resume", str(resumed), flag, *words]).training,
        path,
        new,
    )


def check_changed(
    before: JumpTrainSettings, after: JumpTrainSettings, path: tuple[str, ...], new: Any
) -> None:
    """This value is new, and no other."""
    assert (
        at(after, path) == pytest.approx(new)
        if not isinstance(new, str)
        else at(after, path) == new
    )
    assert changed(before, after) == [".".join((*path, *new) if isinstance(new, dict) else path)]


def test_the_command_line_changes_nothing_of_a_file(
    begun: tuple[JumpTrainSettings, TrainPolicy], tmp_path: Path
) -> None:
    """Nor of what is resumed: values of all fields come through it as they are."""
    before, command = begun
    file, values = tmp_path / "changes.toml", to_table(before)
    file.write_text(tomli_w.dumps(values))
    flags = [
        "--device",
        "cpu",
        "--config",
        str(file),
        *(["--resume", str(command.resume)] if command.resume else []),
    ]
    after = parse(flags).training
    assert after == replace(command, config=file).defaults().training
    assert len(changed(before, after)) >= len(FAMILY)


def to_table(config: Any) -> dict[str, Any]:
    """Another value for each of a configuration, as a file names them."""
    values = {f.name: getattr(config, f.name) for f in fields(config)}
    others = {name: to_table(v) if is_dataclass(v) else other(v) for name, v in values.items()}
    return {name: list(v) if isinstance(v, tuple) else v for name, v in others.items()}


def test_a_flag_wins_over_the_file_and_both_over_the_resumed_training(
    resumed: Path, tmp_path: Path
) -> None:
    file = tmp_path / "changes.toml"
    file.write_text("seed = 3\n[learning]\nepochs = 4\n")
    after = parse(["--resume", str(resumed), "--config", str(file), "--seed", "11"]).training
    assert (after.seed, after.learning.epochs, after.robots) == (11, 4, RESUMED.robots)
    # A default that is said aloud
    assert parse(["--resume", str(resumed), "--seed", "0"]).training.seed == 0


def train(*flags: str) -> int:
    return main(["policy", "train", *TINY, *flags])


def test_a_second_training_writes_over_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert train("--iterations", "1", "--out", str(out)) == 0
    assert "differs from the defaults: robots = 8 (there 256)" in (out / "log.txt").read_text()
    before = (out / "checkpoint.pt").read_bytes()
    capsys.readouterr()
    assert train("--iterations", "1", "--seed", "5", "--out", str(out)) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "seed = 0, not 5" in error
    assert f"--resume {out / 'checkpoint.pt'}" in error
    assert (out / "checkpoint.pt").read_bytes() == before


def test_without_a_folder_each_training_gets_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        assert train("--iterations", "1") == 0
    assert len(list(tmp_path.glob("runs/*-policy-train*/checkpoint.pt"))) == 2


@pytest.mark.parametrize("elsewhere", [False, True])
def test_a_resumed_training_goes_on_with_log_and_tables(
    elsewhere: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("saltus.policy.training.training_record.REPORT_S", 0.0)
    first, second = tmp_path / "first", tmp_path / ("second" if elsewhere else "first")
    assert train("--iterations", "2", "--out", str(first)) == 0
    log = (first / "log.txt").read_text()
    # As of a training that was killed after its last save
    lost = replace_iteration(first / "progress.csv", "2", "9")
    resume = ("--resume", str(first / "checkpoint.pt"), "--out", str(second))
    assert (
        main(
            [
                "policy",
                "train",
                "--device",
                "cpu",
                "--iterations",
                "4",
                "--env.curriculum.gap",
                "0.5",
                *resume,
            ]
        )
        == 0
    )
    text = (second / "log.txt").read_text()
    assert text.startswith(log)
    assert "differs from the resumed training: env.curriculum.gap = 0.5 (there 0.0)" in text
    rows = read_csv_table(second / "progress.csv")
    assert [row["iteration"] for row in rows] == ["1", "3", "4"]
    assert rows[0]["gap/level"] == "nan"
    assert rows[-1]["gap/level"] != "nan"
    assert lost == 2


def replace_iteration(path: Path, old: str, new: str) -> int:
    """Gives the row of an iteration another one; returns the number of rows."""
    rows = path.read_text().splitlines()
    path.write_text("\n".join(re.sub(f"^{old},", f"{new},", row) for row in rows) + "\n")
    return len(rows) - 1


@pytest.mark.parametrize(
    ("program", "number"),
    [
        ("saltus.cli.main policy train", signal.SIGINT),
        pytest.param("saltus.cli.policy_train", signal.SIGTERM, marks=pytest.mark.slow),
    ],
)
def test_an_interruption_saves_and_says_so(program: str, number: int, tmp_path: Path) -> None:
    out = tmp_path / "run"
    command = [sys.executable, "-m", *program.split(), *TINY, "--minutes", "5", "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    while "ready" not in (line := process.stdout.readline()):
        assert line
    process.send_signal(number)
    said, error = process.communicate(timeout=60)
    assert process.returncode == 130
    (line,) = [line for line in said.splitlines() if "interrupted" in line]
    iteration = int(read_policy_checkpoint(out / "checkpoint.pt")["iteration"])
    assert (
        line == f"interrupted: what was learned until iteration {iteration} is in "
        f"{out / 'checkpoint.pt'}"
    )
    assert "Traceback" not in error


def test_networks_of_another_size_do_not_go_on(resumed: Path, tmp_path: Path) -> None:
    command = parse(
        ["--resume", str(resumed), "--learning.hidden", "4", "--out", str(tmp_path / "run")]
    )
    with pytest.raises(
        SaltusError, match=r"learning.hidden = \(4,\): the networks of .* have \(16, 8\)"
    ):
        command.run()


def test_the_shipped_checkpoint_still_loads() -> None:
    path = Path(__file__).parents[2] / "models/checkpoints/policy.pt"
    assert parse(["--resume", str(path)]).training.learning.desired_kl == 0.01


def test_a_jumping_training_that_starts_from_a_file_plans_as_the_file_within_any_bounds() -> None:
    path = shipped_file("models/policy_go2.onnx")
    file = ModelFile(path)
    policy = PolicyActor(load_robot("go2"), LINE, path)
    trained_with = training_config({"config": file.field("config")})
    bounds = trained_with.env.bounds
    wider = ActionBounds(
        low=tuple(1.2 * low - 0.1 for low in bounds.low),
        high=tuple(1.1 * high + 0.2 for high in bounds.high),
    )
    size = size_with(LINE, trained_with.env.past_steps)
    given = np.random.default_rng(3).normal(size=(50, size)).astype(np.float32)
    for new in (bounds, wider):
        config = replace(trained_with, robots=8, env=replace(trained_with.env, bounds=new))
        env = JumpEnv(
            make_engine(load_robot("go2"), 8, config.env, "cpu"), config.env, LINE, seed=0
        )
        learner = JumpLearner(env, config.learning)
        learner.begin_with(file, config.env.curriculum.levels)
        shown = TensorDict({"policy": torch.from_numpy(given)}, batch_size=[50])
        with torch.no_grad():
            plans = new.denormalised(learner.ppo.actor(shown))
        expected = policy.values(given)
        span = np.array(bounds.high) - np.array(bounds.low)
        np.testing.assert_allclose(bounds.clipped(plans).numpy() / span, expected / span, atol=2e-3)
        assert learner.steps == file.field("steps")


def test_a_start_is_for_new_trainings(resumed: Path, tmp_path: Path) -> None:
    command = parse(
        ["--device", "cpu", "--resume", str(resumed), "--start", "models/policy.onnx",
         "--out", str(tmp_path / "run")]
    )  # fmt: skip
    with pytest.raises(SaltusError, match="--start is for new trainings"):
        command.run()
    begun = parse(["--device", "cpu", "--start", "models/policy.onnx"]).training.learning
    assert begun == replace(for_cpu("go1", "line").learning, **STARTED)
