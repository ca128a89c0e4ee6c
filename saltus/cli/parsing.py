"""From the words of a command line to the dataclass that it stands for; what is wrong with them is one line."""

import contextlib
import io
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import tyro

from saltus.errors import SaltusError

BAD_INPUT = 2


def parse(kind: Any, arguments: Sequence[str] | None, *, prog: str, description: str) -> Any:
    """A dataclass, or one of a union of them, from a command line.

    Where a command has a method `defaults`, its flags name which defaults hold, e.g. those of the training that it goes
    on from: the command line is then read once more with these.

    Args:
        kind: What tyro makes a command line of.
        arguments: Without the name of the program; those of this process where they are None.
        prog: The name of the program, for its help.
        description: The text above its options.

    Raises:
        SaltusError: the command line cannot be used; what tyro would print as a box is its message.
    """
    command = _read(kind, arguments, prog, description, tyro.MISSING_NONPROP)
    defaults = _defaults_of(command)
    if defaults is not None:
        command = _read(kind, arguments, prog, description, defaults)
    _check_seeds(command)
    return command


def _defaults_of(command: Any) -> Any:
    """The command with its method `defaults` applied, e.g. to the training that it goes on from; None for others."""
    if hasattr(command, "defaults"):
        return command.defaults()
    inner = getattr(command, "command", None)
    found = None if inner is None else _defaults_of(inner)
    return None if found is None else replace(command, command=found)


def _read(kind: Any, arguments: Sequence[str] | None, prog: str, description: str, default: Any) -> Any:
    """What tyro reads; what it would print as a box becomes one line."""
    box = io.StringIO()
    try:
        with contextlib.redirect_stderr(box):
            return tyro.cli(kind, prog=prog, description=description, args=arguments, default=default)
    except SystemExit as error:
        if error.code == BAD_INPUT:
            raise SaltusError(_one_line(box.getvalue())) from None
        raise


def _check_seeds(command: object) -> None:
    """Of the command, and of those that it holds: numpy's generators take no negative ones."""
    for name, value in vars(command).items():
        if name in ("seed", "first_seed") and value is not None and value < 0:
            raise SaltusError(f"{name} = {value}: seeds are not negative")
        if name == "command":
            _check_seeds(value)


def _one_line(box: str) -> str:
    """The message of tyro's error box without its frame, title and rules."""
    lines = [re.sub(r"[│╭╮╰╯─]+|-{5,}", " ", line).strip() for line in box.splitlines()[1:]]
    return re.sub(r"\s+", " ", " ".join(line for line in lines if line))
