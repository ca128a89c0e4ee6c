"""Keeps a page up to date until it is told to stop, and does what is pressed on it."""

import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from saltus.folders import new_folder
from saltus.watch.page import Page, RunRequest, StartRequest
from saltus.watch.panel import BAD
from saltus.watch.source import SceneSource
from saltus.wire.sharing import PERIOD_S

DRAWN_HZ = 1.0 / PERIOD_S  # a picture of each batch
LOOK_S = 0.5  # how often it looks whether runs have begun or ended
UNWATCHED_S = 0.2  # how often it looks whether somebody watches
END_S = 10.0  # a robot lands and stands within 1.5 s, of the run's clock
ERRORS_FILE = "up.log"


class PageWatcher:
    """Shows sources on a page.

    A run that is started on it, by a thread of `starters`, takes their place.
    """

    def __init__(
        self, page: Page, sources: list[SceneSource], starters: ThreadPoolExecutor
    ) -> None:
        self._page = page
        self._sources = sources
        self._starters = starters
        self._started: subprocess.Popen[bytes] | None = None
        self._folder = Path()
        self._looked_s = float("-inf")
        self._shown: tuple[float, bool, bool] | None = None
        self._arrange()

    def run(self) -> None:
        """Draws at `DRAWN_HZ` while somebody watches; does next to nothing while nobody does."""
        last_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            self.step(now_s - last_s)
            last_s = now_s
            period_s = 1.0 / DRAWN_HZ if self._page.watched else UNWATCHED_S
            time.sleep(max(0.001, now_s + period_s - time.monotonic()))

    def step(self, seconds: float) -> None:
        """One picture, so many seconds after the last one."""
        while not self._page.pressed.empty():
            self._do(self._page.pressed.get())
        if not self._page.watched:
            for source in self._sources:
                source.leave()
            self._looked_s = float("-inf")
            return
        if time.monotonic() - self._looked_s > LOOK_S:
            self._looked_s = time.monotonic()
            self._look()
        self._page.advance(seconds)
        now = (self._page.time_s, self._page.follows, self._page.playing)
        if now == self._shown and not any(source.live is not None for source in self._sources):
            return  # a recording that pauses, whose numbers were shown once since
        self._shown = now
        self._page.show(
            [
                source.scene(self._page.time_s)
                for source in self._sources
                if source.world is not None
            ]
        )

    def close(self) -> None:
        """Leaves the runs, and ends one that was started here: its robot lands."""
        for source in self._sources:
            source.leave()
        if self._started is not None and self._started.poll() is None:
            self._started.send_signal(signal.SIGINT)
            try:
                self._started.wait(END_S)
            except subprocess.TimeoutExpired:
                self._started.kill()

    def _look(self) -> None:
        changed = [source.look() for source in self._sources]
        if any(changed):
            self._arrange()
        self._say()

    def _say(self) -> None:
        failed = self._started is not None and self._started.poll() not in (None, 0)
        if failed and all(source.world is None for source in self._sources):
            lines = (
                (self._folder / ERRORS_FILE)
                .read_text(errors="replace", encoding="utf-8")
                .strip()
                .splitlines()
            )
            self._page.say(lines[-1] if lines else "the run has ended", BAD)
        elif any(source.live is not None for source in self._sources):
            self._page.say("live")
        elif any(source.duration_s for source in self._sources):
            self._page.say("recording")
        elif self._sources:
            self._page.say("waiting for the run to begin")
        else:
            self._page.say("no run: start one")

    def _arrange(self) -> None:
        self._shown = None
        several = len(self._sources) > 1
        self._page.arrange(
            [
                replace(source.world, title=f"{source.name}: {source.world.title}")
                if several
                else source.world
                for source in self._sources
                if source.world is not None
            ],
            max((source.duration_s for source in self._sources), default=0.0),
            may_ask=any(source.may_ask for source in self._sources),
        )

    def _do(self, pressed: StartRequest | RunRequest) -> None:
        if isinstance(pressed, StartRequest):
            self._start(pressed)
            return
        for source in self._sources:
            if source.live is not None and source.may_ask:
                source.live.ask(pressed.code, pressed.detail)

    def _start(self, start: StartRequest) -> None:
        if self._started is not None and self._started.poll() is None:
            return  # one at a time
        for source in self._sources:
            source.leave()
        self._folder = new_folder("watch")
        self._folder.mkdir(parents=True)
        pace = ["--pace", "lockstep"] if start.speed == "lockstep" else ["--speed", start.speed]
        with (self._folder / ERRORS_FILE).open("wb") as errors:
            self._started = self._starters.submit(
                subprocess.Popen[bytes],
                [
                    sys.executable, "-P", "-m", "saltus.cli.main", "up", "--terrain", start.terrain,
                    "--seed", str(start.seed), *pace, "--out", str(self._folder),
                ],
                stdout=subprocess.DEVNULL, stderr=errors, start_new_session=True,
            ).result()  # fmt: skip
        self._sources = [SceneSource(self._folder)]
        self._arrange()
