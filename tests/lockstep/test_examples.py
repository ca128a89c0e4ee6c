"""The commands of the tutorial on trainings, a run with what they made,
and the library on its recording.
"""

import re
import runpy
import shlex
import sys
from pathlib import Path

import pytest

from saltus.cli.main import main

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "tutorials" / "predictor.md").read_text()


def commands() -> list[list[str]]:
    """The words of each command of the page."""
    blocks = "".join(re.findall(r"```\n(.*?)```", PAGE, re.DOTALL)).replace("\\\n", "")
    return [shlex.split(line, comments=True) for line in blocks.splitlines()]


@pytest.mark.slow
def test_from_small_trainings_to_a_run_and_its_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for program, *words in commands():
        assert program == "saltus"
        # Networks of two updates fall
        assert main(words) in ((0, 1) if words[0] == "demo" else (0,))
    assert (tmp_path / "runs/own/recording.mcap").exists()
    capsys.readouterr()
    monkeypatch.setattr(sys, "argv", ["library.py", "runs/own/recording.mcap"])
    runpy.run_path(str(ROOT / "examples" / "library.py"), run_name="__main__")
    look, rollout, heights = capsys.readouterr().out.splitlines()
    assert look.startswith("stairs: 4 boxes, heights [0.0, 0.1, 0.2] m")
    assert rollout.startswith("2 of 2 robots crossed")
    assert float(re.findall(r"([\d.]+) mm", heights)[0]) < 20.0
