"""`saltus real2sim`: from an experiment to a log, from a patch to a profile that every command takes by its name."""

import json
from pathlib import Path

import pytest
from samples import PROFILE, ROBOT

from saltus.cli.main import main
from saltus.effects.offsets_and_factors import CoulombFriction
from saltus.effects.profile import load_profile
from saltus.errors import ConfigError
from saltus.real2sim.patch import Applicability, Patch
from saltus.real2sim.search.findings import FoundEffect, Interval
from saltus.recordings.run_log import read_run_log

BAD = {
    "no command": (["real2sim"], "find"),
    "no such log": (["real2sim", "find", "missing"], "missing"),
    "no log": (["real2sim", "find"], "run log"),
    "unknown profile of find": (["real2sim", "find", "missing", "--profile", "g1"], "go1"),
    "no such patch": (["real2sim", "apply", "missing.toml", "--profile", "mine"], "missing.toml"),
    "unknown experiment": (["real2sim", "experiments", "--run", "joint_chrip"], "joint_chirp"),
    "list and run": (["real2sim", "experiments", "--list", "--run", "drop"], "--list"),
    "negative latency": (["real2sim", "experiments", "--run", "drop", "--camera-latency", "-1"], "--camera-latency"),
    "latency not a number": (["real2sim", "experiments", "--run", "drop", "--camera-latency", "nan"], "0 to 1 s"),
    "negative seed": (["real2sim", "find", "missing", "--seed", "-1"], "seed"),
    "out is below a file": (["real2sim", "experiments", "--run", "drop", "--out", "/dev/null/log"], "/dev/null/log"),
}


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SALTUS_PROFILES", raising=False)


@pytest.fixture
def patch(tmp_path: Path) -> Path:
    friction = FoundEffect(
        name="coulomb_friction",
        where=("FR_calf",),
        params={"torque": Interval(value=0.3, ci90=(0.28, 0.32), unit="Nm")},
    )
    path = tmp_path / "patch.toml"
    path.write_text(Patch(effects=(friction,), evidence=(), range=Applicability()).to_toml())
    return path


@pytest.mark.parametrize("case", BAD, ids=str)
def test_bad_input_is_one_line_that_helps_and_exit_code_2(case: str, capsys: pytest.CaptureFixture[str]) -> None:
    arguments, hint = BAD[case]
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("saltus: ")
    assert hint in captured.err


def test_the_list_of_experiments_says_what_each_shows(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["real2sim", "experiments", "--list", "--json"]) == 0
    table = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert {"joint_chirp", "wall_two_ranges", "drop"} <= {entry["name"] for entry in table["experiments"]}
    assert all(entry["shows"] and entry["limits"] and entry["duration_s"] > 0 for entry in table["experiments"])


def test_an_experiment_leaves_a_run_log(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["real2sim", "experiments", "--run", "drop", "--profile", "ideal", "--out", "log", "--json"]) == 0
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    log = read_run_log(Path(said["log"]))
    assert log.meta["base"] == "free"
    assert said["seconds"] == pytest.approx(log.joints.time_s[-1] - log.joints.time_s[0])


def test_a_patch_becomes_a_profile_that_is_found_by_name(patch: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["real2sim", "apply", str(patch), "--profile", "mine", "--base", "go1", "--json"]) == 0
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert said == {"profile": "mine", "file": "profiles/mine.toml", "added": ["coulomb_friction"]}
    profile = load_profile("mine", ROBOT)
    assert profile.camera == PROFILE.camera
    assert set(PROFILE.actuator) < set(profile.actuator)
    (friction,) = set(profile.actuator) - set(PROFILE.actuator)
    assert isinstance(friction, CoulombFriction)
    assert main(["real2sim", "apply", str(patch), "--profile", "mine"]) == 0, "a patch may be applied again"
    assert load_profile("mine", ROBOT) == profile


def test_profiles_that_are_shipped_are_not_overwritten(patch: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["real2sim", "apply", str(patch), "--profile", "go1"]) == 2
    assert "go1" in capsys.readouterr().err
    assert load_profile("go1", ROBOT) == PROFILE


def test_a_name_that_is_no_profile_is_told_with_the_nearest(patch: Path) -> None:
    assert main(["real2sim", "apply", str(patch), "--profile", "mine"]) == 0
    with pytest.raises(ConfigError, match="mine"):
        load_profile("mien", ROBOT)


@pytest.mark.parametrize("command", ["find", "apply", "experiments", "demo"])
def test_the_help_shows_an_example_and_what_holds_without_a_flag(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["real2sim", command, "--help"])
    said = capsys.readouterr().out
    assert ended.value.code == 0
    assert said.count(f"saltus real2sim {command} ") >= 2, "beside the usage"
    assert "None" not in said


def test_an_experiment_is_not_written_over_a_run_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "log").mkdir()
    (tmp_path / "log" / "meta.json").write_text("{}")
    assert main(["real2sim", "experiments", "--run", "drop", "--out", "log"]) == 2
    assert "another folder" in capsys.readouterr().err
    assert (tmp_path / "log" / "meta.json").read_text() == "{}"
