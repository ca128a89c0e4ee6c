"""What holds for every page that Saltus writes."""

import re
from html.parser import HTMLParser
from pathlib import Path

from saltus.reports.page import PLOTLY

MOST_BYTES = 1_000_000


class Tags(HTMLParser):
    """Each tag that is opened is closed, in order."""

    WITHOUT_END = ("meta", "img", "br")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, _: list[tuple[str, str | None]]) -> None:
        self.open += [] if tag in self.WITHOUT_END else [tag]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, self.getpos()


def opens_without_a_network(page: Path) -> None:
    """It is small and whole, and all that it loads lies beside it."""
    text = page.read_text()
    tags = Tags()
    tags.feed(text)
    assert tags.open == []
    loaded = re.findall(
        r"<(?:script|link|img|iframe|video|source)[^>]*?\b(?:src|href)=\"([^\"]*)\"", text
    )
    beside = {name for name in loaded if not name.startswith("data:")}
    assert all((page.parent / name).is_file() for name in beside), beside
    assert (PLOTLY in beside) == ("Plotly.newPlot(" in text)
    assert "https://" not in re.sub(r"<a href=[^>]*>", "", text).replace("https://plot.ly", "")
    assert len(text.encode()) <= MOST_BYTES
