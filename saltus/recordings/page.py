"""Pages with figures: what all reports look like, and what draws their figures without a network.

A page is small, as the program that draws, plotly, lies beside it: once in a folder, whatever pages it holds.
"""

import html
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import numpy as np
import plotly
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

PLOTLY = f"plotly-{plotly.__version__}.min.js"
"""The file beside a page."""
_MISSING = f"<p class=bad>The figures of this page need the file {PLOTLY}, which lay beside it. Copy both.</p>"
_TOLD = f"window.addEventListener('load', () => document.body.insertAdjacentHTML('afterbegin', '{_MISSING}'))"
_LOADED = f'<script src="{PLOTLY}" onerror="{_TOLD}"></script>'
_FIGURE = 'class="plotly-graph-div"'
STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; color: #222; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin: 2em 0 0.3em; } p.note { color: #555; margin: 0.2em 0; }
table { border-collapse: collapse; margin: 0.5em 0; } td, th { padding: 0.25em 0.9em; text-align: right; }
th { border-bottom: 2px solid #888; } td:first-child, th:first-child { text-align: left; }
tr:nth-child(even) { background: #f4f4f4; } table.text td, table.text th { text-align: left; white-space: nowrap; }
table.text td:last-child { white-space: normal; } pre { background: #f4f4f4; padding: 1em; overflow-x: auto; }
.good { color: #00664a; } .bad { color: #b03a00; }
"""


def page(title: str, body: str, more_style: str = "") -> str:
    """A whole page in the style of all reports; title and parts are HTML."""
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{STYLE}{more_style}</style>{_LOADED if _FIGURE in body else ''}</head><body>{body}</body></html>"
    )


def write_page(path: Path, text: str) -> None:
    """Writes what `page` made, whole or not at all, and beside it what draws its figures; `OSError` where it cannot."""
    brought = bring_plotly(path.parent, text)
    try:
        _write_whole(path, text)
    except OSError:
        if brought:
            (path.parent / PLOTLY).unlink(missing_ok=True)
        raise


def bring_plotly(folder: Path, text: str) -> bool:
    """Puts what draws figures beside a page that has any, where it is not there yet; returns whether it did."""
    if _FIGURE not in text or (folder / PLOTLY).exists():
        return False
    _write_whole(folder / PLOTLY, get_plotlyjs())
    return True


def _write_whole(path: Path, text: str) -> None:
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def figure_html(figure: go.Figure) -> str:
    """A figure as part of a page."""
    figure.update_layout(template="simple_white", hovermode="closest", legend_itemsizing="constant")
    if figure.layout.margin.l is None:
        figure.update_layout(margin={"l": 60, "r": 20, "t": 20, "b": 50})
    for trace in figure.data:
        for axis in {"x", "y", "z"} & set(trace):
            if isinstance(trace[axis], np.ndarray) and trace[axis].dtype == np.float64:
                trace[axis] = trace[axis].astype(np.float32)  # more digits than a screen shows, in half of the page
    fragment: str = figure.to_html(full_html=False, include_plotlyjs=False)
    return fragment


def table(head: Iterable[str], rows: Iterable[Iterable[object]], kind: str = "") -> str:
    """A table of a page; cells are text. `kind` is "text" where they are words, not numbers."""
    cells = "".join("<tr>" + "".join(f"<td>{html.escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<table class="{kind}"><tr>{"".join(f"<th>{html.escape(name)}</th>" for name in head)}</tr>{cells}</table>'
