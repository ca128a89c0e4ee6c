"""A hook of MkDocs: puts into the site what lies outside of docs/,
under the links that work on GitHub too.

Pages keep their relative links. README.md becomes the first page; other Markdown keeps its path; a
file of code that a page links to becomes a page that shows it; a notebook becomes a page of its
cells, with the text and the pictures that it holds. The reference of the Python API is made from
its docstrings.
"""

import base64
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import saltus

ROOT = Path(__file__).resolve().parents[1]
DOCS = "docs/"
FIRST = "README.md"
ELSEWHERE = (FIRST, "CHANGELOG.md", "CONTRIBUTING.md", "zenoh_cfg/README.md")
"""Pages outside of docs/ that others do not link to, or that links are to be followed from."""
LINK = re.compile(r"(\]\()([^)\s#:]+)((?:#[^)\s]*)?\))")
API = "reference/python.md"
NOTEBOOK = ".ipynb"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds what is linked to, page by page."""
    waiting = [DOCS + file.src_uri for file in files.documentation_pages()] + list(ELSEWHERE)
    known = set(waiting)
    while waiting:
        path = waiting.pop()
        if not path.startswith(DOCS):
            files.append(File.generated(config, _in_site(path), content=_text(path)))
        if path.endswith(".md"):
            linked = {
                _target(path, link)
                for _, link, _ in LINK.findall((ROOT / path).read_text(encoding="utf-8"))
            } - known
            found = [
                other for other in linked if (ROOT / other).is_file() and not other.startswith(DOCS)
            ]
            known.update(found)
            waiting.extend(found)
    files.append(File.generated(config, API, content=_api()))
    for path in sorted((ROOT / DOCS).rglob(f"*{NOTEBOOK}")):
        for place, content in _notebook(path.relative_to(ROOT / DOCS)):
            files.append(File.generated(config, place, content=content))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001
    """Turns links between places in the repository into links between places in the site."""
    here = page.file.src_uri
    path = _in_repository(here)

    def moved(link: re.Match[str]) -> str:
        there = _in_site(_target(path, link[2]))
        return f"{link[1]}{os.path.relpath(there, os.path.dirname(here) or '.')}{link[3]}"  # noqa: PTH120 - no file

    return LINK.sub(moved, markdown) if (ROOT / path).is_file() else markdown


def _in_site(path: str) -> str:
    """Where a file of the repository is in the site."""
    if path == FIRST:
        return "index.md"
    if path.startswith(DOCS):
        place = path.removeprefix(DOCS)
        return f"{place.removesuffix(NOTEBOOK)}.md" if place.endswith(NOTEBOOK) else place
    return path if path.endswith(".md") else f"{path}.md"


def _in_repository(place: str) -> str:
    """The opposite, for pages of Markdown."""
    if place == "index.md":
        return FIRST
    if (ROOT / place).is_file():
        return place
    notebook = f"{DOCS}{place.removesuffix('.md')}{NOTEBOOK}"
    return notebook if (ROOT / notebook).is_file() else DOCS + place


def _target(path: str, link: str) -> str:
    """Returns what a link on a page leads to, from the root of the repository."""
    return os.path.normpath(os.path.join(os.path.dirname(path), link))  # noqa: PTH118, PTH120 - neither need exist


def _text(path: str) -> str:
    """The page of a file: itself, or its code."""
    text = (ROOT / path).read_text(encoding="utf-8")
    return text if path.endswith(".md") else f"# {path}\n\n```{Path(path).suffix[1:]}\n{text}```\n"


def _notebook(path: Path) -> Iterator[tuple[str, str | bytes]]:
    """The page of a notebook under docs/ and its pictures, each with its place in the site."""
    parts: list[str] = []
    pictures = 0
    for cell in json.loads((ROOT / DOCS / path).read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", ()):
            if "text" in output:
                parts.append(f"```text\n{''.join(output['text']).rstrip()}\n```")
            else:
                pictures += 1
                picture = f"{path.stem}-{pictures}.png"
                parts.append(f"![Picture {pictures}]({picture})")
                yield (
                    path.with_name(picture).as_posix(),
                    base64.b64decode(output["data"]["image/png"]),
                )
    parts.insert(1, f'This page is a notebook: <a href="{path.name}" download>{path.name}</a>.')
    yield path.with_suffix(".md").as_posix(), "\n\n".join(parts) + "\n"


def _api() -> str:
    """The page on what `import saltus` offers: functions first,
    then the types that they take and return.
    """
    names = sorted(saltus.__all__, key=lambda name: (not name[0].islower(), name.lower()))
    places = [
        f"::: {home}.{name}" for name in names for home, own in saltus._HOMES.items() if name in own
    ]
    said = (
        "What `import saltus` offers, made from the docstrings. [Saltus from "
        "Python](../python.md) shows it in use."
    )
    return "\n\n".join((f"# Python\n\n{said}", *places)) + "\n"
