"""Simulated robots, and commands, in processes of their own."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def saltus(*command: str, **streams: int) -> Iterator["subprocess.Popen[str]"]:
    with subprocess.Popen(
        [sys.executable, "-P", "-m", "saltus.cli.main", *command],
        stdout=subprocess.PIPE, text=True, **streams,
    ) as process:  # fmt: skip
        try:
            yield process
        finally:
            process.terminate()


@contextlib.contextmanager
def simulated(domain: int, *more: str) -> Iterator["subprocess.Popen[str]"]:
    """A simulated robot that has begun."""
    with saltus("robot", "simulate", "--domain", str(domain), *more) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("simulated go2")
        yield process
