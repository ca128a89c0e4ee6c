"""tools/stress_tests.py: every file is run in each way, and what passed not again."""

import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
FILES = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "tests").rglob("test_*.py"))


@pytest.fixture
def tool(tmp_path: Path) -> Any:
    """The script with a folder of its own for what it keeps."""
    names = runpy.run_path(str(ROOT / "tools" / "stress_tests.py"))
    of_its_functions = names["main"].__globals__
    of_its_functions |= {"FOLDER": tmp_path, "DONE": tmp_path / "done.json"}
    return SimpleNamespace(given=of_its_functions, **names)


def test_each_phase_has_every_file_once_and_orders_differ(tool: Any) -> None:
    every = tool.pieces(["alone", "order", "busy"], [], 3, 2)
    assert len({piece.name for piece in every}) == len(every)
    runs: dict[str, list[str]] = {}
    for piece in every:
        phase, number = piece.name.split()[:2]
        runs.setdefault(phase if phase == "alone" else f"{phase} {number}", []).extend(piece.files)
    assert runs.keys() == {"alone", "order 0", "order 1", "order 2", "busy 0", "busy 1"}
    assert all(sorted(files) == FILES for files in runs.values())
    assert len({tuple(files) for files in runs.values()}) == 4  # three orders, and the usual one


@pytest.mark.parametrize("size", [1, 14, 10_000])
def test_an_order_is_the_same_in_parts_of_any_size(tool: Any, size: int) -> None:
    usual = tool.pieces(["order", "busy"], [], 2, 1)
    parts = tool.pieces(["order", "busy"], [], 2, 1, part=size)
    assert not {piece.name for piece in usual} & {piece.name for piece in parts}
    assert max(len(piece.files) for piece in parts) == min(size, len(FILES))
    assert [(file, piece.seed) for piece in usual for file in piece.files] == [
        (file, piece.seed) for piece in parts for file in piece.files
    ]


def test_a_run_of_some_tests_is_another_than_one_of_all(tool: Any) -> None:
    every, quick = (tool.pieces(["order"], [], 1, 0, marks) for marks in ("", "not slow"))
    assert [piece.files for piece in quick] == [piece.files for piece in every]
    assert {piece.marks for piece in quick} == {"not slow"}
    assert not {piece.name for piece in quick} & {piece.name for piece in every}


def test_what_passed_is_not_run_again_and_what_failed_is(
    tool: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: list[str] = []

    def result(passed: Callable[[str], bool]) -> Callable[..., Any]:
        def run(piece: Any, commit: str) -> Any:
            ran.append(piece.name)
            failed = [] if passed(piece.name) else [f"{piece.files[0]}::test_a"]
            return tool.Outcome(not failed, failed, 1.0, 1.0, commit)

        return run

    monkeypatch.setattr(sys, "argv", ["stress_tests.py", "--phases", "alone", "--only", *FILES[:3]])
    monkeypatch.setitem(tool.given, "reference_s", lambda: 1.0)
    monkeypatch.setitem(tool.given, "run", result(lambda name: name != f"alone {FILES[1]}"))
    assert tool.main() == 1
    assert f"failed: alone {FILES[1]}: {FILES[1]}::test_a" in capsys.readouterr().out
    monkeypatch.setitem(tool.given, "run", result(lambda _: True))
    assert tool.main() == 0
    assert ran == [*(f"alone {file}" for file in FILES[:3]), f"alone {FILES[1]}"]
