"""Pages with figures in a browser that has no network: drawn with plotly beside them, and told where it is missing."""

from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest
from browser import browser
from report_pages import opens_without_a_network

from saltus.recordings.page import PLOTLY, figure_html, page, write_page
from saltus.recordings.report import contact_figure

CURVES = 2


@pytest.fixture
def written(tmp_path: Path) -> Path:
    x = np.linspace(0.0, 1.0, 100)
    figures = [figure_html(go.Figure(go.Scatter(x=x, y=x**power))) for power in range(1, CURVES + 1)]
    path = tmp_path / "report.html"
    write_page(path, page("Curves", "".join(figures)))
    return path


def test_figures_are_drawn_where_plotly_lies_beside_the_page_and_else_the_page_says_so(written: Path) -> None:
    opens_without_a_network(written)
    with browser() as tab:
        tab.open(written.as_uri())
        drawn = "document.querySelectorAll('.scatterlayer path.js-line').length"
        tab.until(lambda: tab.run(drawn) == CURVES, "figures")
        assert PLOTLY not in tab.text()
        (written.parent / PLOTLY).unlink()
        tab.open(written.as_uri())
        tab.until(lambda: PLOTLY in tab.text(), "the note on the missing file")
        assert tab.run(drawn) == 0


def test_a_page_without_figures_brings_nothing(tmp_path: Path) -> None:
    write_page(tmp_path / "report.html", page("Words", "<p>None</p>"))
    opens_without_a_network(tmp_path / "report.html")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.parametrize("seed", range(5))
def test_lines_of_contact_are_those_of_every_sample(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time_s, stands = 0.01 * np.arange(300), np.repeat(rng.random((60, 4)) < 0.5, 5, axis=0)
    figure = contact_figure(time_s, ("FR", "FL", "RR", "RL"), stands, ~stands)
    for index in range(4):
        for mask, line in ((stands, figure.data[2 * index]), (~stands, figure.data[2 * index + 1])):
            there = np.interp(time_s, line.x, np.isfinite(line.y))  # between two kept samples nothing changes
            assert np.array_equal(there == 1.0, mask[:, index])
