"""The page of two recordings in a real browser:
what it says and draws, its time line and its buttons.
"""

import re
from collections.abc import Iterator

import numpy as np
import pytest
from browser import Tab, browser
from page import page_of
from recorded import STEPS, run_samples, write

SHARP = "?fixedDpr=1"  # a page that is slow to draw draws fewer pixels, by default
WIDTH, HEIGHT = 1300, 560
GROUND = slice(200, None), slice(310, 490)
"""Rows and columns of a picture between the panels, below what the browser says of its speed."""


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    folder = tmp_path_factory.mktemp("recordings")
    for name in ("one.mcap", "two.mcap"):
        write(folder / name, list(run_samples()))
    page = page_of("watch", "one.mcap", "two.mcap", "--port", "0", folder=folder)
    with page as (address, _), browser(WIDTH, HEIGHT) as tab:
        tab.open(address + SHARP)
        tab.until(lambda: tab.text().count("heightmap/heightmap") == 2, "a panel of each run")
        yield tab


def slider(tab: Tab) -> float:
    return float(tab.run("document.querySelector('[role=slider]').getAttribute('aria-valuenow')"))


def play(tab: Tab, *, on: bool) -> None:
    """Lets the time go on, or stand still, whatever it did before."""
    button, other = ("Play", "Pause") if on else ("Pause", "Play")
    if button in tab.text():
        tab.click(button)
    tab.until(lambda: other in tab.text(), f"the button '{other}'")


def test_both_runs_say_what_they_are_and_how_they_do(tab: Tab) -> None:
    play(tab, on=True)
    for said in ("one: gap, seed 7", "two: gap, seed 7", "recording"):
        assert said in tab.text()
    for said in (
        "controller/state",
        "policy/plan",
        "status/controller",
        "16 x 48 pixels",
        "mean error",
    ):
        tab.until(lambda said=said: tab.text().count(said) == 2, f"'{said}' of each run")


def test_the_time_line_plays_pauses_and_is_dragged(tab: Tab) -> None:
    play(tab, on=True)
    tab.until(lambda: slider(tab) > 0.0, "a time")
    play(tab, on=False)
    tab.run("document.querySelector('[role=slider]').focus()")
    last_s = (STEPS - 1) * 0.01
    for key, time_s in (("End", last_s), ("Home", 0.0), ("End", last_s)):
        tab.press(key)
        tab.until(
            lambda time_s=time_s: slider(tab) == pytest.approx(time_s, abs=0.011),
            f"the time {time_s}",
        )
        tab.until(lambda time_s=time_s: f"{time_s:.2f} s" in tab.text(), f"the scene of {time_s} s")
    assert "Play" in tab.text()


def test_a_page_that_pauses_tells_the_numbers_of_its_picture(tab: Tab) -> None:
    """While it plays, numbers come less often than pictures."""

    def told() -> list[float]:
        return [float(found) for found in re.findall(r"time\n([\d.]+) s", tab.text())]

    for _ in range(6):
        play(tab, on=True)
        tab.until(lambda: slider(tab) > 0.0, "a time")
        play(tab, on=False)
        tab.until(lambda: told() == pytest.approx([slider(tab)] * 2, abs=0.011), "its numbers")


def test_the_picture_is_drawn_follows_the_time_and_stands_still_while_it_pauses(tab: Tab) -> None:
    """Robots and ground move from the first scene to the last.

    What does not change is drawn as before.
    """

    def drawn(key: str, time_s: float) -> np.ndarray:
        tab.press(key)
        tab.until(lambda: f"{time_s:.2f} s" in tab.text(), f"the scene of {time_s} s")
        return tab.settled(lambda: tab.picture()[GROUND].astype(int))

    play(tab, on=False)
    tab.run("document.querySelector('[role=slider]').focus()")
    first, last = drawn("Home", 0.0), drawn("End", (STEPS - 1) * 0.01)
    assert first.std() > 5.0
    assert np.abs(first - last).max(axis=-1).mean() > 1.0
    np.testing.assert_array_equal(first, drawn("Home", 0.0))
