"""The stack with the learned policy: it plans, it bounds, and it repeats to the bit."""

import json
import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest

from saltus.cli.main import main
from saltus.config import RunConfig, load
from saltus.model_file import ModelFile
from saltus.recordings.recording import read_recording
from saltus.resources import resource
from saltus.terrain.terrain import Terrain

EXAMPLE = Path(__file__).parents[2] / "examples" / "course.toml"
FLAGS = [
    "demo",
    "--terrain",
    "flat",
    "--planner",
    "learned",
    "--seed",
    "3",
    "--time-limit-s",
    "2.5",
    "--camera",
    "ideal",
]


def test_two_lockstep_runs_with_the_learned_policy_are_equal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tables = []
    for name in ("first", "second"):
        main([*FLAGS, "--no-video", "--json", "--out", str(tmp_path / name)])
        tables.append(json.loads(capsys.readouterr().out.splitlines()[-1]))
    first, second = tables
    assert load(RunConfig, tmp_path / "first" / "run.toml").planner == "learned"
    assert first["digest"] == second["digest"] != ""
    assert first["distance_m"] == second["distance_m"] > 1.0  # 1 s of standing, then at more than 1 m/s


def test_a_course_of_ones_own_is_crossed_from_its_file_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    course = tmp_path / "course.toml"
    shutil.copy(EXAMPLE, course)
    assert main(["demo", "--terrain", str(course), "--no-video", "--json", "--out", str(tmp_path / "run")]) == 0
    course.unlink()  # the recording has it
    recording = read_recording(tmp_path / "run" / "recording.mcap")
    assert recording.terrain == load(Terrain, EXAMPLE)
    table = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert table["terrain"] == recording.terrain.kind
    heights = recording.terrain.height_at(np.array([1.0, 2.0, 3.0, 4.2, 6.2465, 8.0]), 0.0)
    np.testing.assert_allclose(heights, [0.0, 0.2, 0.4, 0.1, 0.6, 0.8], atol=1e-3)


def test_models_of_ones_own_are_run_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = {}
    for kind in ("heightmap", "policy"):
        model = onnx.load(resource(f"models/{kind}.onnx"))
        model.doc_string = "somebody's own"
        own[kind] = tmp_path / f"{kind}.onnx"
        onnx.save(model, own[kind])
    flags = [f"--{kind}-model={path}" for kind, path in own.items()]
    main([*FLAGS, *flags, "--no-video", "--json", "--out", str(tmp_path / "run")])
    table = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert table["models"] == {kind: ModelFile(path).model_id for kind, path in own.items()}
    assert table["distance_m"] > 1.0
    report = (tmp_path / "run" / "report.html").read_text()
    for kind, name in table["models"].items():
        assert ModelFile(resource(f"models/{kind}.onnx")).model_id != name
        assert f"{kind} model = {name}" in report
    assert read_recording(tmp_path / "run" / "recording.mcap").models == table["models"]
