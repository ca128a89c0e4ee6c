"""The commands of docs/examples.md that no other test runs: small trainings, a run with what they made, the library."""

import re
import runpy
import shlex
import sys
from pathlib import Path

import pytest

from saltus.cli.main import main

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "examples.md").read_text()


def commands(section: str) -> list[list[str]]:
    """The words of each command below a headline."""
    text = PAGE.split(f"## {section}\n")[1].split("\n## ")[0]
    blocks = "".join(re.findall(r"```\n(.*?)```", text, re.DOTALL)).replace("\\\n", "")
    return [shlex.split(line, comments=True) for line in blocks.splitlines()]


def test_from_small_trainings_to_a_run_and_its_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for program, *words in commands("Your policy and your predictor"):
        assert program == "saltus"
        assert main(words) in ((0, 1) if words[0] == "demo" else (0,))  # networks of two updates fall
    assert (tmp_path / "runs/own/recording.mcap").exists()
    ((program, example, *words),) = commands("Saltus from Python")
    assert program == "python"
    capsys.readouterr()
    monkeypatch.setattr(sys, "argv", [example, *words])
    runpy.run_path(str(ROOT / example), run_name="__main__")
    look, rollout, heights = capsys.readouterr().out.splitlines()
    assert look.startswith("stairs: 4 boxes, heights [0.0, 0.1, 0.2] m")
    assert rollout.startswith("2 of 2 robots crossed")
    assert float(re.findall(r"([\d.]+) mm", heights)[0]) < 20.0


def test_files_and_pages_that_it_names_are_there() -> None:
    names = re.findall(r"\]\(([^)#]+)\)", PAGE) + re.findall(r"examples/[\w./]+\.(?:py|toml)", PAGE)
    assert len(names) > 10
    for name in names:
        assert (ROOT / "docs" / name).exists() or (ROOT / name).exists(), name
