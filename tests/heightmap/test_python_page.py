"""`import saltus`: what it offers, what it loads, and the page that shows it."""

import ast
import json
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from recorded_run import glide, record
from samples import ROBOT

import saltus
from saltus.cli.main import main
from saltus.config import TerrainConfig

ROOT = Path(__file__).parents[2]
BLOCKS = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "python.md").read_text(), re.DOTALL)


@pytest.mark.slow
def test_the_page_runs_and_prints_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    run = glide(TerrainConfig(), steps=240)
    (tmp_path / "runs" / "one").mkdir(parents=True)
    blind = saltus.predict_heights(ROBOT, [], run.states)
    record(tmp_path / "runs" / "one" / "recording.mcap", run, blind)
    assert main(["real2sim", "experiments", "--run", "joint_chirp", "--out", "logs/chirp"]) == 0
    names: dict[str, object] = {}
    checked = 0
    for block in BLOCKS:
        capsys.readouterr()
        exec(block, names)  # noqa: S102 - a page of this repository
        said = capsys.readouterr().out.splitlines()
        prints = [line for line in block.splitlines() if line.lstrip().startswith("print(")]
        for line, printed in zip(prints, said, strict=False):
            if expected := re.search(r"\)  # (.*)$", line):
                assert printed == expected[1], line
                checked += 1
    assert checked >= 10
    assert (tmp_path / "runs" / "found" / "verdict.json").exists()


def test_an_import_loads_nothing_but_the_package_itself() -> None:
    code = (
        "import sys; before = set(sys.modules); import saltus; "
        "print(*sorted(set(sys.modules) - before))"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert {name.split(".")[0] for name in loaded} - sys.stdlib_module_names == {"saltus"}
    assert [name for name in loaded if name.startswith("saltus.")] == []


def test_what_types_are_checked_by_is_what_is_there() -> None:
    (guarded,) = [
        node
        for node in ast.parse(Path(saltus.__file__).read_text()).body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    ]
    typed = {
        alias.asname: line.module
        for line in guarded.body
        if isinstance(line, ast.ImportFrom)
        for alias in line.names
    }
    assert sorted(typed) == sorted(saltus.__all__) == sorted(set(dir(saltus)) & set(saltus.__all__))
    for name, home in typed.items():
        assert getattr(saltus, name) is getattr(import_module(str(home)), name)
    misspelled = "make_terrian"
    with pytest.raises(AttributeError, match=misspelled):
        getattr(saltus, misspelled)


BAD_STATES = {
    "base_height": (np.zeros(2), r"base_height has the shape \(2,\): it must be \(3,\)"),
    "joint_position": (np.full((3, 12), np.nan), "joint_position holds values that are not finite"),
}


@pytest.mark.parametrize("name", BAD_STATES)
def test_arrays_that_do_not_fit_are_named(name: str) -> None:
    arrays = {
        "quaternion_base_in_world": np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)),
        "angular_velocity_base": np.zeros((3, 3)),
        "joint_position": np.zeros((3, 12)), "velocity_base_in_world": np.zeros((3, 3)),
        "base_height": np.zeros(3),
        "leg_trusted": np.ones((3, 4)),
    }  # fmt: skip
    saltus.robot_states([0.0, 0.01, 0.02], **arrays)
    with pytest.raises(saltus.SaltusError, match=BAD_STATES[name][1]):
        saltus.robot_states([0.0, 0.01, 0.02], **arrays | {name: BAD_STATES[name][0]})
    with pytest.raises(saltus.SaltusError, match="times that rise"):
        saltus.robot_states([0.0, 0.02, 0.01], **arrays)


@pytest.mark.parametrize(
    ("depth_m", "said"),
    [
        (np.zeros((2, 48, 16)), r"it must be \(3, 48, 16\)"),
        (np.full((3, 48, 16), np.nan), "no number"),
        (np.full((3, 48, 16), -1.0), "negative"),
    ],
)
def test_images_that_do_not_fit_are_refused(depth_m: np.ndarray, said: str) -> None:
    camera = saltus.Intrinsics(width=16, height=48, fx=42.0, fy=42.0, cx=8.0, cy=24.0)
    with pytest.raises(saltus.SaltusError, match=said):
        saltus.depth_frames(camera, depth_m, [0.0, 0.02, 0.04])


def test_a_trial_is_what_the_command_makes_of_its_seed(capsys: pytest.CaptureFixture[str]) -> None:
    course = TerrainConfig(terrain="step", height_m=1.0)  # a robot falls before it at once
    words = [
        "--terrain",
        "step",
        "--height-m",
        "1.0",
        "--trials",
        "1",
        "--seed",
        "4",
        "--no-report",
        "--json",
    ]
    assert main(["policy", "eval", *words, "--processes", "1"]) == 1
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    steps: list[saltus.Moment] = []
    (outcome,) = saltus.roll_out(
        ROBOT, saltus.make_terrain(course), trials=1, seed=4, on_step=steps.append
    )
    assert vars(outcome) == told["outcomes"][0]
    start, *_, last = (step.truth.position_base_in_world[0, 0] for step in steps if step.running[0])
    # A step further: 0.01 s at less than 5 m/s
    assert last - start == pytest.approx(outcome.distance_m, abs=0.05)
    with pytest.raises(saltus.SaltusError, match="trials = 0"):
        saltus.roll_out(ROBOT, saltus.make_terrain(course), trials=0)
