"""The command line: what is wrong is said in one line, with exit code 2."""

import json

import pytest

from saltus.cli.main import main
from saltus.cli.output import finite

BAD = {
    "no command": ([], "demo"),
    "unknown command": (["dem"], "demo"),
    "unknown flag": (["demo", "--sead", "3"], "--seed"),
    "unknown terrain": (["demo", "--terrain", "stair"], "stairs"),
    "not a number": (["demo", "--seed", "three"], "three"),
    "size out of range": (["demo", "--rise-m", "-1"], "-1"),
    "difficulty out of range": (["demo", "--difficulty", "2"], "2"),
    "unknown profile": (["demo", "--profile", "g1"], "go1"),
    "folder that cannot be": (["demo", "--out", "/dev/null/run"], "--out"),
    "no such recording": (["replay", "missing.mcap"], "missing.mcap"),
    "negative seed": (["demo", "--seed", "-1"], "seed = -1"),
    "negative seed of a command of a command": (["real2sim", "demo", "--seed", "-1"], "seed = -1"),
    "no time": (["demo", "--time-limit-s", "0"], "time_limit_s"),
    "time that is no number": (["demo", "--time-limit-s", "nan"], "time_limit_s"),
    "stereo images by another renderer": (["demo", "--camera", "d435i", "--renderer", "pyrender"], "embree"),
    "no dataset": (["heightmap", "dataset", "info", "/dev/null/data"], "/dev/null/data"),
    "nothing to merge": (["heightmap", "dataset", "merge", "--out", "/dev/null/data"], "nothing to merge"),
    "no episodes": (["heightmap", "collect", "cpu", "--batches", "0"], "batches = 0"),
    "no robots": (["heightmap", "dagger", "--loop.robots", "0", "--out", "/dev/null/run"], "robots = 0"),
    "predictor where none is": (["heightmap", "collect", "cpu", "--predictor", "a.pt"], "--predictor"),
    "unknown baseline": (["heightmap", "eval", "--baselines", "geometrik"], "geometric"),
    "time in which robots stand": (["heightmap", "eval", "--time-limit-s", "0.1"], "time_limit_s"),
    "file where a folder is asked for": (["heightmap", "export", "--out", "model.onnx"], "name a folder"),
    "no such run": (["heightmap", "give", "models/heightmap.onnx", "--run-dir", "nowhere"], "nowhere"),
    "folder for a report that cannot be": (["policy", "eval", "--trials", "1", "--out", "/dev/null/run"], "/dev/null"),
}


@pytest.mark.parametrize("case", BAD, ids=str)
def test_bad_input_is_one_line_that_helps_and_exit_code_2(case: str, capsys: pytest.CaptureFixture[str]) -> None:
    arguments, hint = BAD[case]
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("saltus: ")
    assert hint in captured.err
    assert captured.out == ""


@pytest.mark.parametrize("command", [[], ["demo"], ["heightmap"], ["replay"], ["doctor"], ["bench"]], ids=str)
def test_help_exits_with_0(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main([*command, "--help"])
    assert stopped.value.code == 0
    assert "usage: saltus" in capsys.readouterr().out


def test_json_has_no_infinities() -> None:
    table = finite({"a": float("inf"), "b": [float("nan"), 1.0], "c": {"d": (2.0, float("-inf"))}})
    assert json.loads(json.dumps(table, allow_nan=False)) == {"a": None, "b": [None, 1.0], "c": {"d": [2.0, None]}}
