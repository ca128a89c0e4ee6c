"""`saltus watch`: a page in the browser that shows runs and recordings."""

import contextlib
import importlib.util
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from saltus.errors import SaltusError
from saltus.flags import shown

PORT = 8080
VISER = "pip install 'saltus[watch]'"
NICENESS = 10  # the stack comes first


@dataclass(frozen=True, kw_only=True)
class Watch:
    """Shows runs and recordings on a page in the browser, until Ctrl-C: robot, ground, depth, heights, plans, topics.

    For example:
      saltus watch
      saltus watch runs/one
      saltus watch runs/one/recording.mcap runs/two/recording.mcap
      saltus watch runs/fleet --robots robot/0 robot/1
    """

    runs: Annotated[tyro.conf.Positional[tuple[Path, ...]], shown("PATH", "none, start one on the page")] = ()
    """Recordings, and folders of runs, which may go on, have ended or be yet to begin; several stand
    beside each other."""
    robots: Annotated[tuple[str, ...], shown("PREFIX", "the one that each folder names")] = ()
    """Prefixes of the robots' keys, where several share the router of one folder."""
    port: int = PORT
    """Of the page, on this machine only; the next free one where it is taken."""

    def run(self) -> int:
        """Prints the address, and keeps the page up to date until Ctrl-C."""
        ask_for_viser()
        if self.robots and len(self.runs) != 1:
            raise SaltusError(f"--robots names robots of one folder, and {len(self.runs)} are given")
        if not 0 <= self.port < 65536:
            raise SaltusError(f"port = {self.port}: it must be from 0 (any that is free) to 65535")
        from saltus.watch.page import Page
        from saltus.watch.server import Server
        from saltus.watch.source import Source
        from saltus.watch.watcher import Watcher

        sources = [Source(path, robot) for path in self.runs for robot in self.robots or ("",)]
        os.nice(NICENESS)
        server = Server(self.port)
        watcher = Watcher(Page(server), sources)
        print(f"watch at {server.address} until Ctrl-C", flush=True)
        try:
            watcher.run()
        finally:
            watcher.close()
            server.stop()
        return 0


def ask_for_viser() -> None:
    """Raises `SaltusError` where the package is not installed that makes the page."""
    if importlib.util.find_spec("viser") is None:
        raise SaltusError("a page to watch needs the package 'viser', which is not installed: " + VISER)


@contextlib.contextmanager
def watching(run_dir: Path) -> Iterator["subprocess.Popen[bytes]"]:
    """Shows a run that is about to begin, in a process of its own: the supervisor has other things to do."""
    ask_for_viser()
    command = [sys.executable, "-P", "-m", "saltus.cli.main", "watch", str(run_dir)]
    with subprocess.Popen(command, start_new_session=True) as page:  # Ctrl-C reaches this process alone
        try:
            yield page
        finally:
            page.terminate()
