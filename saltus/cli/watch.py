"""`saltus watch`: a page in the browser that shows runs and recordings."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from saltus.errors import SaltusError
from saltus.extras import check_package
from saltus.flags import flag_help
from saltus.tuning import stand_back

PORT = 8080


@dataclass(frozen=True, kw_only=True)
class Watch:
    """Shows runs and recordings on a page in the browser, until Ctrl-C:
    robot, ground, depth, heights, plans, topics.

    For example:
      saltus watch
      saltus watch runs/one
      saltus watch runs/one/recording.mcap runs/two/recording.mcap
      saltus watch runs/fleet --robots robot/0 robot/1
    """

    runs: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], flag_help("PATH", "none, start one on the page")
    ] = ()
    """Recordings, and folders of runs, which may go on, have ended or be yet to begin;
    several stand beside each other."""
    robots: Annotated[tuple[str, ...], flag_help("PREFIX", "the one that each folder names")] = ()
    """Prefixes of the robots' keys, where several share the router of one folder."""
    port: Annotated[
        int | None, flag_help("INT", f"{PORT}, the next free one where it is taken")
    ] = None
    """Port of the page, on this machine only."""

    def run(self) -> int:
        """Prints the address, and keeps the page up to date until Ctrl-C."""
        if self.port is not None and not 0 <= self.port < 65536:
            raise SaltusError(f"port = {self.port}: it must be from 0 (any that is free) to 65535")
        ask_for_viser()
        if self.robots and len(self.runs) != 1:
            raise SaltusError(
                f"--robots names robots of one folder, and {len(self.runs)} are given"
            )
        from saltus.watch.page import Page
        from saltus.watch.server import PageServer
        from saltus.watch.source import SceneSource
        from saltus.watch.watcher import PageWatcher

        sources = [SceneSource(path, robot) for path in self.runs for robot in self.robots or ("",)]
        with ThreadPoolExecutor(1) as starters:
            starters.submit(
                int
            ).result()  # so its thread is there, with the priority that runs are to have
            stand_back()
            server = PageServer(PORT if self.port is None else self.port)
            watcher = PageWatcher(Page(server), sources, starters)
            print(f"watch at {server.address} until Ctrl-C", flush=True)
            tell_of_no_run(self.runs)
            try:
                watcher.run()
            finally:
                watcher.close()
                server.stop()
        return 0


def tell_of_no_run(paths: Sequence[Path]) -> None:
    """Says which of what is to be watched is not there, and so is waited for.

    An empty folder is what a run makes that is about to begin.
    """
    from saltus.recordings.recorder import RECORDING_FILE
    from saltus.runtime.run_folder import RUN_FILE

    for path in paths:
        if path.is_file() or any((path / name).exists() for name in (RUN_FILE, RECORDING_FILE)):
            continue
        if path.is_dir() and not any(path.iterdir()):
            continue
        there = "there is no run in" if path.is_dir() else "there is no"
        print(
            f"saltus: {there} '{path}' yet: waiting for one to begin there, e.g. "
            f"saltus up --out {path}",
            file=sys.stderr, flush=True,
        )  # fmt: skip


def ask_for_viser() -> None:
    """Raises `SaltusError` where the package is not installed that makes the page."""
    check_package("viser", "watch", "a page to watch needs")


@contextlib.contextmanager
def watching(run_dir: Path) -> Iterator["subprocess.Popen[bytes]"]:
    """Shows a run that is about to begin, in a process of its own:
    the supervisor has other things to do.
    """
    ask_for_viser()
    command = [sys.executable, "-P", "-m", "saltus.cli.main", "watch", str(run_dir)]
    with subprocess.Popen(
        command, start_new_session=True
    ) as page:  # Ctrl-C reaches this process alone
        try:
            yield page
        finally:
            page.terminate()
