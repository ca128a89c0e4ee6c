"""Pages with figures, made of templates, which open without a network.

A page's template extends `page.html` and has `figure` and `table` at hand. A page is small: plotly,
which draws its figures, lies once in a folder, whatever pages it holds.
"""

from pathlib import Path

import numpy as np
import plotly
import plotly.graph_objects as go
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from saltus.files import write_whole
from saltus.reports.page_templates import TEMPLATES, template_beside

PLOTLY = f"plotly-{plotly.__version__}.min.js"
"""The file beside a page."""


def figure(drawn: go.Figure) -> Markup:
    """A figure as part of a page."""
    drawn.update_layout(template="simple_white", hovermode="closest", legend_itemsizing="constant")
    if drawn.layout.margin.l is None:
        drawn.update_layout(margin={"l": 60, "r": 20, "t": 20, "b": 50})
    for trace in drawn.data:
        for axis in {"x", "y", "z"} & set(trace):
            if isinstance(trace[axis], np.ndarray) and trace[axis].dtype == np.float64:
                # More digits than a screen shows, in half of the page
                trace[axis] = trace[axis].astype(np.float32)
    return Markup(drawn.to_html(full_html=False, include_plotlyjs=False))  # noqa: S704 # plotly escapes it


TEMPLATES.globals |= {"figure": figure, "plotly": PLOTLY}


def render_page(module_file: str, **shown: object) -> str:
    """The page of values, by the template beside a module: `module_file` is its `__file__`."""
    return template_beside(module_file).render(shown)


def write_page(path: Path, text: str) -> None:
    """Writes a page whole or not at all, and beside it what draws its figures;
    `OSError` where it cannot.
    """
    brought = bring_plotly(path.parent, text)
    try:
        write_whole(path, text)
    except OSError:
        if brought:
            (path.parent / PLOTLY).unlink(missing_ok=True)
        raise


def bring_plotly(folder: Path, text: str) -> bool:
    """Puts what draws figures beside a page that has any, where it is not there yet.

    Returns whether it did.
    """
    if f'src="{PLOTLY}"' not in text or (folder / PLOTLY).exists():
        return False
    write_whole(folder / PLOTLY, get_plotlyjs())
    return True
