"""What holds for every page that Saltus writes."""

import re
from pathlib import Path

from saltus.reports.page import PLOTLY

MOST_BYTES = 1_000_000


def opens_without_a_network(page: Path) -> None:
    """It is small, and all that it loads lies beside it."""
    text = page.read_text()
    loaded = re.findall(r"<(?:script|link|img|iframe|video|source)[^>]*?\b(?:src|href)=\"([^\"]*)\"", text)
    beside = {name for name in loaded if not name.startswith("data:")}
    assert all((page.parent / name).is_file() for name in beside), beside
    assert (PLOTLY in beside) == ("Plotly.newPlot(" in text)
    assert "https://" not in re.sub(r"<a href=[^>]*>", "", text).replace("https://plot.ly", "")
    assert len(text.encode()) <= MOST_BYTES
