"""A command that serves at an address, which it prints, as a user starts it."""

import contextlib
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def page_of(
    *command: str, folder: Path, scheme: str = "http"
) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """The address that a command prints, which runs in a folder until the end."""
    saltus = [sys.executable, "-P", "-m", "saltus.cli.main", *command]
    with subprocess.Popen(saltus, stdout=subprocess.PIPE, text=True, cwd=folder) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            address = re.search(rf"{scheme}://\S+", line)
            assert address, f"no address in '{line}'"
            yield address[0], process
        finally:
            process.terminate()
