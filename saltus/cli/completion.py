"""`saltus --completion SHELL`: the script with which a shell completes commands and flags."""

import contextlib
import io
from typing import Any

import tyro

from saltus.errors import SaltusError, nearest_hint

SHELLS = ("bash", "zsh")


def completion_script(command: Any, shell: str) -> str:
    """The script for the commands of a union.

    Raises:
        SaltusError: another shell.
    """
    if shell not in SHELLS:
        raise SaltusError(f"--completion {shell}: {nearest_hint(shell, SHELLS)}")
    script = io.StringIO()
    with contextlib.redirect_stdout(script), contextlib.suppress(SystemExit):
        tyro.cli(command, prog="saltus", args=["--tyro-print-completion", shell])
    # Of a description in several lines a shell would take the second for another flag
    lines = script.getvalue().splitlines()
    return "\n".join(
        line.replace("\\n", " ") if line.startswith("COMPLETION_SPEC") else line for line in lines
    )
