"""An installation has one top-level name: what lies
in the current folder is never taken for a part of Saltus.
"""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

SALTUS = Path(sys.executable).with_name("saltus")
NAMES = ("policy", "controller", "render", "heightmap", "real2sim", "tests", "saltus", "queue")
TRAP = "raise SystemExit(f'{__file__} was imported')\n"


Trap = Callable[[Path, str], None]


def package(folder: Path, name: str) -> None:
    (folder / name).mkdir()
    (folder / name / "__init__.py").write_text(TRAP)


def module(folder: Path, name: str) -> None:
    (folder / f"{name}.py").write_text(TRAP)


def last_line(folder: Path, *arguments: str) -> Any:
    run = subprocess.run([SALTUS, *arguments, "--json"], cwd=folder, capture_output=True, text=True)
    assert run.returncode in (0, 1), run.stderr  # 1: it ran, and the robot did not arrive
    return json.loads(run.stdout.splitlines()[-1])


@pytest.mark.parametrize("trap", [package, module])
def test_they_break_no_command(trap: Trap, tmp_path: Path) -> None:
    for name in NAMES:
        trap(tmp_path, name)
    assert last_line(tmp_path, "real2sim", "experiments")


@pytest.mark.slow
def test_they_break_neither_a_run_nor_its_processes(tmp_path: Path) -> None:
    for name in NAMES:
        package(tmp_path, name)
    flags = ["--terrain", "flat", "--camera", "ideal", "--time-limit-s", "0.3", "--no-video"]
    table = last_line(tmp_path, "demo", *flags, "--out", "run")
    assert table["digest"]
    assert table["rejected"] == {}


@pytest.mark.slow
def test_they_break_no_workers(tmp_path: Path) -> None:
    for name in NAMES:
        module(tmp_path, name)
    course = ["--terrain", "step", "--height-m", "1.0"]  # robots fall before it at once
    flags = [*course, "--trials", "2", "--heightmap", "true-exact", "--processes", "2"]
    assert last_line(tmp_path, "policy", "eval", *flags, "--out", "run")
