"""`saltus real2sim`: from an experiment to a log,
from a patch to a profile that every command takes by its name.
"""

import json
from pathlib import Path

import pytest
from samples import PROFILE, ROBOT

from saltus.cli.main import main
from saltus.effects.joint_loads import CoulombFriction
from saltus.effects.profile import load_profile
from saltus.errors import ConfigError
from saltus.real2sim.patch import PatchRange, ProfilePatch
from saltus.real2sim.search.findings import FoundEffect, ParameterInterval
from saltus.recordings.run_log import read_run_log


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SALTUS_PROFILES", raising=False)


@pytest.fixture
def patch(tmp_path: Path) -> Path:
    friction = FoundEffect(
        name="coulomb_friction",
        where=("FR_calf",),
        params={"torque": ParameterInterval(value=0.3, ci90=(0.28, 0.32), unit="Nm")},
    )
    path = tmp_path / "patch.toml"
    path.write_text(ProfilePatch(effects=(friction,), evidence=(), range=PatchRange()).to_toml())
    return path


def test_the_list_of_experiments_says_what_each_shows(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["real2sim", "experiments", "--json"]) == 0
    table = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert {"joint_chirp", "wall_two_ranges", "drop"} <= {
        entry["name"] for entry in table["experiments"]
    }
    assert all(
        entry["shows"] and entry["limits"] and entry["duration_s"] > 0
        for entry in table["experiments"]
    )


def test_an_experiment_leaves_a_run_log(capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(
            [
                "real2sim",
                "experiments",
                "--run",
                "drop",
                "--profile",
                "ideal",
                "--out",
                "log",
                "--json",
            ]
        )
        == 0
    )
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    log = read_run_log(Path(said["log"]))
    assert log.meta["base"] == "free"
    assert said["seconds"] == pytest.approx(log.joints.time_s[-1] - log.joints.time_s[0])


def test_a_patch_becomes_a_profile_that_is_found_by_name(
    patch: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(["real2sim", "apply", str(patch), "--profile", "mine", "--base", "go1", "--json"]) == 0
    )
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    file, names = "profiles/mine.toml", ["coulomb_friction"]
    assert said == {"profile": "mine", "file": file, "added": names, "updated": [], "lacks": []}
    profile = load_profile("mine", ROBOT)
    assert profile.camera == PROFILE.camera
    assert set(PROFILE.actuator) < set(profile.actuator)
    (friction,) = set(profile.actuator) - set(PROFILE.actuator)
    assert isinstance(friction, CoulombFriction)
    assert main(["real2sim", "apply", str(patch), "--profile", "mine"]) == 0, (
        "a patch may be applied again"
    )
    assert "mine with coulomb_friction updated\n" in capsys.readouterr().out
    assert load_profile("mine", ROBOT) == profile


def test_effects_of_the_shipped_profile_that_a_new_one_lacks_are_named(
    patch: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["real2sim", "apply", str(patch), "--profile", "mine"]) == 0
    said = capsys.readouterr().out
    assert "ideal with coulomb_friction added\n" in said
    assert all(name in said for name in PROFILE.effects)
    assert "--base shipped" in said


def test_profiles_that_are_shipped_are_not_overwritten(
    patch: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["real2sim", "apply", str(patch), "--profile", "go1"]) == 2
    assert "go1" in capsys.readouterr().err
    assert load_profile("go1", ROBOT) == PROFILE


def test_a_name_that_is_no_profile_is_told_with_the_nearest(patch: Path) -> None:
    assert main(["real2sim", "apply", str(patch), "--profile", "mine"]) == 0
    with pytest.raises(ConfigError, match=r"no file /.*/profiles/mien\.toml: did you mean 'mine'"):
        load_profile("mien", ROBOT)


def test_an_experiment_is_not_written_over_a_run_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "log").mkdir()
    (tmp_path / "log" / "meta.json").write_text("{}")
    assert main(["real2sim", "experiments", "--run", "drop", "--out", "log"]) == 2
    assert "another folder" in capsys.readouterr().err
    assert (tmp_path / "log" / "meta.json").read_text() == "{}"
