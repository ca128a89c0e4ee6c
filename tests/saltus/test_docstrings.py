"""Docstrings name their subject: each can be read without the name above it."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("saltus", "heightmap", "render", "policy", "controller", "real2sim")
BESIDE = ("paper", "benchmarks", "examples", "tools")
SUBJECTLESS = re.compile(r"(What|Of|That|Who|Whose|Whether)\b")


def docstrings(source: str) -> Iterator[tuple[int, str]]:
    """Line and text of each: of modules, classes and functions, of fields and constants."""
    for node in ast.walk(ast.parse(source)):
        for part in node.body if isinstance(getattr(node, "body", None), list) else ():
            value = part.value if isinstance(part, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                yield part.lineno, value.value.strip()


def test_docstrings_begin_with_their_subject() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text.splitlines()[0]}"
        for room in (*ROOMS, *BESIDE)
        for path in sorted((ROOT / room).rglob("*.py"))
        for line, text in docstrings(path.read_text(encoding="utf-8"))
        if SUBJECTLESS.match(text)
    ]
    assert found == []
