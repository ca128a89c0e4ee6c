"""Text is UTF-8 wherever a computer stands: no call leaves it to the locale,
and commands print in any of them.
"""

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from saltus.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("saltus", "heightmap", "render", "policy", "controller", "real2sim")
BESIDE = ("paper", "benchmarks", "examples", "tools")
TEXTS = {"read_text": 0, "write_text": 1}
"""Calls that always read or write text, and how many arguments come before the encoding."""
OPENERS = {"open": 1, "fdopen": 1, "NamedTemporaryFile": 0, "TemporaryFile": 0, "makefile": 0}
"""Calls that do where their mode says no `b`, and which argument the mode is.

That of a method `open` is the first.
"""
BINARY_OPENERS = {"NamedTemporaryFile", "TemporaryFile"}  # where no mode is given
OTHERS = {"zenoh.open", "os.open", "Image.open", "writer.open"}  # which open no file as text
PROCESSES = {"run", "Popen", "check_output", "call", "check_call"}


def left_to_the_locale(source: str) -> Iterator[int]:
    """Lines with a call that reads or writes text in the encoding of whoever runs it."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and _is_left(
            node, {keyword.arg: keyword.value for keyword in node.keywords}
        ):
            yield node.lineno


def _is_left(call: ast.Call, keywords: dict[str | None, ast.expr]) -> bool:
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    if "encoding" in keywords or ast.unparse(call.func) in OTHERS:
        return False
    if name in TEXTS:
        return len(call.args) <= TEXTS[name]
    if name in PROCESSES:
        return bool(keywords.keys() & {"text", "universal_newlines"})
    if name not in OPENERS:
        return False
    place = 0 if isinstance(call.func, ast.Attribute) and name == "open" else OPENERS[name]
    mode = call.args[place] if len(call.args) > place else keywords.get("mode")
    if mode is None:
        return name not in BINARY_OPENERS
    return not (isinstance(mode, ast.Constant) and "b" in str(mode.value))


def test_no_text_is_left_to_the_locale() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}"
        for room in (*ROOMS, *BESIDE)
        for path in sorted((ROOT / room).rglob("*.py"))
        for line in left_to_the_locale(path.read_text(encoding="utf-8"))
    ]
    assert not found, f'name encoding="utf-8" in: {", ".join(found)}'


IN_ASCII = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
"""A locale that has fewer signs than any other."""
PRINTED = """
import sys
from pathlib import Path
from saltus.cli.main import main
from saltus.reports.page import render_page, write_page
from saltus.robots.loading import load_robot

folder = Path(sys.argv[1])
assert sys.stdout.encoding.lower() not in ("utf-8", "utf8")
template = "{% extends 'page.html' %}{% block body %}gap \u00d7 {{ shown }}{% endblock %}"
(folder / "page.html").write_text(template, encoding="utf-8")
write_page(folder / "written.html", render_page(str(folder / "page.py"), shown="30 \u00b0"))
codes = []
for words in sys.argv[2:]:
    try:
        codes.append(main(words.split()))
    except SystemExit as end:
        codes.append(end.code)
print(*codes, "\u00d7")
"""
COMMANDS = {
    "--help": 0,
    "demo --help": 0,
    "heightmap collect cpu --help": 0,
    "real2sim find --help": 0,
    "robot show go1": 0,
    "bench": 0,
    "demo --terrain st\u00e4irs": 2,
    "robot show {folder}/r\u00f6bot.xml": 2,
    "camera show {folder}/latin.toml": 2,
    "camera show {folder}/marked.toml --out {folder}/camera": 0,
}


def test_commands_print_and_pages_are_written_in_any_locale(tmp_path: Path) -> None:
    (tmp_path / "latin.toml").write_bytes("# 30 \u00b0\n".encode("latin-1"))
    (tmp_path / "marked.toml").write_bytes("\ufeff# 30 \u00b0, \u4e00\n".encode())
    words = [command.format(folder=tmp_path) for command in COMMANDS]
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            PRINTED.replace("\u00d7", "\\xd7").replace("\u00b0", "\\xb0"),
            str(tmp_path),
            *words,
        ],
        env={**os.environ, **IN_ASCII},
        capture_output=True,
        timeout=120,
        check=False,
    )
    assert b"Traceback" not in done.stderr
    assert done.returncode == 0, done.stderr
    *codes, sign = done.stdout.splitlines()[-1].split()
    assert [int(code) for code in codes] == list(COMMANDS.values()), done.stderr
    assert sign == b"?"
    assert "gap \u00d7 30 \u00b0" in (tmp_path / "written.html").read_text(encoding="utf-8")
    assert b"latin.toml: not valid TOML: it is not text in UTF-8" in done.stderr


@pytest.mark.parametrize(
    ("value", "code"), [("foo", 2), ("EGL", 0), ("osmesa", 0), ("glfw", 0), ("", 0), ("off", 0)]
)
def test_commands_run_whatever_the_engine_is_told_to_draw_with(
    value: str, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MUJOCO_GL", value)
    assert main(["robot", "show", "go1"]) == code
    told = capsys.readouterr().err
    assert (
        told == ""
        if code == 0
        else told.startswith("saltus: MUJOCO_GL = foo: ") and told.count("\n") == 1
    )
