"""The documentation site: it builds without a warning,
opens without a network, and what it says of errors is true.
"""

import ast
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from unittest import mock
from urllib.parse import unquote, urlparse

import pytest

from saltus.cli.main import command_of
from saltus.errors import SaltusError, check_known
from saltus.extras import check_package, packages_of

pytestmark = pytest.mark.site

ROOT = Path(__file__).parents[2]
FETCHED = {
    ("script", "src"),
    ("img", "src"),
    ("link", "href"),
    ("iframe", "src"),
    ("video", "src"),
    ("source", "src"),
}
"""What a browser loads by itself; other addresses are for a reader to follow."""


class Page(HTMLParser):
    """The addresses on a page, and the places on it that addresses lead to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[tuple[str, str, str]] = []
        self.places: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("href", "src"):
                self.links.append((tag, name, value or ""))
            elif name in ("id", "name"):
                self.places.add(value or "")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(  # not with --quiet, which hides warnings from --strict, too
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {
        path: Page(path.read_text()) for path in site.rglob("*.html") if path.name != "404.html"
    }


@pytest.mark.slow
def test_every_address_on_every_page_leads_somewhere(pages: dict[Path, Page]) -> None:
    assert len(pages) > 30
    lost = []
    for path, page in pages.items():
        for _, _, link in page.links:
            address = urlparse(link)
            if address.scheme in ("http", "https", "mailto", "data"):
                continue
            there = (path.parent / unquote(address.path)).resolve() if address.path else path
            has_place = (
                not address.fragment or there not in pages or _has(pages[there], address.fragment)
            )
            if not there.is_file() or not has_place:
                lost.append(f"{path.name}: {link}")
    assert lost == []


def _has(page: Page, fragment: str) -> bool:
    return unquote(fragment) in page.places or fragment.startswith("__")


@pytest.mark.slow
def test_a_page_fetches_nothing_from_a_network(site: Path, pages: dict[Path, Page]) -> None:
    fetched = [
        link for page in pages.values() for tag, name, link in page.links if (tag, name) in FETCHED
    ]
    assert len(fetched) > 100
    assert [
        link
        for link in fetched
        if urlparse(link).scheme in ("http", "https") or link.startswith("//")
    ] == []
    sheets = list(site.rglob("*.css"))
    assert sheets
    for sheet in sheets:
        assert not re.search(r"(url\(|@import )['\"]?(https?:)?//", sheet.read_text()), sheet


@pytest.mark.slow
def test_the_reference_shows_all_that_is_offered(site: Path) -> None:
    import saltus

    shown = Page((site / "reference" / "python.html").read_text()).places
    for name in saltus.__all__:
        assert any(place.endswith(f".{name}") for place in shown), name


def test_every_message_that_is_explained_is_one_of_saltus() -> None:
    headings = re.findall(
        r"^### `(.*)`$", (ROOT / "docs" / "troubleshooting.md").read_text(), re.MULTILINE
    )
    assert len(headings) > 25
    rooms = ("saltus", "heightmap", "render", "policy", "controller", "real2sim")
    known = "\0".join(
        text
        for room in rooms
        for path in (ROOT / room).rglob("*.py")
        for text in _texts(ast.parse(path.read_text()))
    )
    wanted = {
        each: "[^\0]*".join(map(re.escape, each.replace("'", "`").strip("… ").split("…")))
        for each in headings
    }
    assert [heading for heading, pattern in wanted.items() if not re.search(pattern, known)] == []


def _texts(module: ast.Module) -> list[str]:
    """Texts of a module but its docstrings; what is filled in is `…`."""
    documented = {
        ast.get_docstring(n, clean=False) for n in ast.walk(module) if isinstance(n, DOCUMENTED)
    }
    found = []
    for node in ast.walk(module):
        if isinstance(node, ast.JoinedStr):
            found.append(_filled(node))
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in REFUSALS:
            found.append(_refusal(node.func.id, [_filled(each) for each in node.args]))  # type: ignore[attr-defined]
        elif (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and node.value not in documented
        ):
            found.append(node.value)
    return [text.replace("'", "`") for text in found]


def _filled(node: ast.expr) -> str:
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    return "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in parts)


def _refusal(function: str, told: list[str]) -> str:
    """The text of an error that a function of saltus words, as it is with these arguments."""
    with (
        mock.patch("importlib.util.find_spec", return_value=None),
        pytest.raises(SaltusError) as caught,
    ):
        REFUSALS[function](*told)
    return str(caught.value)


def _without_package(extra: str, *what: str) -> None:
    with packages_of(extra, *what):
        raise ImportError(name="…")


REFUSALS: dict[str, Callable[..., None]] = {
    "check_known": lambda what, *_: check_known(what, "…", ()),
    "check_package": check_package,
    "packages_of": _without_package,
}
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def test_every_command_on_every_page_is_one_that_saltus_takes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(ROOT)
    found = []
    for path in [*ROOT.glob("docs/**/*.md"), *ROOT.glob("*.md"), *ROOT.glob("models/*.md")]:
        text = path.read_text().replace("\\\n", " ")
        blocks = re.findall(r"^```(?:sh)?\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
        found += [(path.name, line.strip()) for block in blocks for line in block.splitlines()]
    commands = [(page, line) for page, line in found if line.startswith("saltus ")]
    assert len(commands) > 50
    refused = []
    for page, line in commands:
        words = shlex.split(line, comments=True)[1:]
        if "--version" in words or "--help" in words:
            continue
        try:
            command_of(words)
        except SaltusError as error:
            refused.append(f"{page}: {line}: {error}")
    assert refused == []
