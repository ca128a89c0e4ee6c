"""From the words of a command line to the dataclass that it stands for.

What is wrong with them is one line.
"""

import contextlib
import io
from collections.abc import Sequence
from dataclasses import fields, replace
from itertools import groupby
from typing import Any

import tyro

from saltus.errors import SaltusError, nearest_hint

BAD_INPUT = 2
EVERYWHERE = ("--help", "--version", "--completion")
ROBOTS_PAGE = "docs/robots.md says what takes another"
LARGEST_SEED = 2**63 - 1


def parse(kind: Any, arguments: Sequence[str] | None, *, prog: str, description: str | None) -> Any:
    """A dataclass, or one of a union of them, from a command line, by default that of this process.

    Where a command has a method `defaults`, its flags name which defaults hold, e.g. those of the
    training that it continues: the command line is then read once more with these.

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
    """The command with its method `defaults` applied,
    e.g. to the training that it resumes; None for others.
    """
    if hasattr(command, "defaults"):
        # The command line is read once more: a flag that it turns on would be turned off where it
        # is the default.
        return replace(
            command.defaults(), **{f.name: False for f in fields(command) if f.default is False}
        )
    inner = getattr(command, "command", None)
    found = None if inner is None else _defaults_of(inner)
    return None if found is None else replace(command, command=found)


def _read(
    kind: Any,
    arguments: Sequence[str] | None,
    prog: str,
    description: str | None,
    default: Any,
) -> Any:
    """Reads by tyro; its box of an error becomes one line."""
    box = io.StringIO()
    try:
        with contextlib.redirect_stderr(box):
            return tyro.cli(
                kind, prog=prog, description=description, args=arguments, default=default
            )
    except SystemExit as error:
        if error.code == BAD_INPUT:
            raise SaltusError(_one_line(box.getvalue())) from None
        raise


def _check_seeds(command: object) -> None:
    """Checks seeds of the command and of those that it holds:
    numpy's generators and TOML both take them.
    """
    for name, value in vars(command).items():
        if name in ("seed", "first_seed") and value is not None and not 0 <= value <= LARGEST_SEED:
            raise SaltusError(f"{name} = {value}: it must be from 0 to {LARGEST_SEED}")
        if name == "command":
            _check_seeds(value)


def _one_line(box: str) -> str:
    """Words of tyro without the box around them; for an unknown name the nearest known one."""
    lines = [line.strip("│╭╮╰╯─ ") for line in box.splitlines()[1:]]
    parts = [list(part) for is_text, part in groupby(lines, bool) if is_text]
    said = " ".join(parts[0])
    if said.startswith("Unrecognized"):
        return _unknown(said, parts)
    # e.g. (--seed INT)
    allowed = [f" ({part[1]})" for part in parts if part[0] == "Argument helptext:"]
    return said + "".join(allowed)


def _unknown(said: str, parts: list[list[str]]) -> str:
    """Error for a word that is not understood,
    with what is like it among the commands or flags that tyro lists.
    """
    word = said.partition("options:")[2].split()[0].rstrip(",")
    listed: dict[str, list[str]] = {}
    for first, *more in parts[1:]:
        if first.startswith("Available subcommands:"):
            known = " ".join([first, *more]).partition(": ")[2].split(", ")
            return f"there is no command '{word}': {nearest_hint(word, [*known, *EVERYWHERE])}"
        flag = ""
        for line in more:
            if line.startswith("--"):
                flag = line.split()[0]
                listed.setdefault(flag, [])
            elif line.startswith("in ") and flag:
                listed[flag].append(line.removeprefix("in ").removesuffix(" --help"))
    own = [
        flag
        for flag, commands in listed.items()
        if any(f"(applied to {name})" in said for name in commands)
    ]
    if word == "--robot" and "--robots" not in own:
        return (
            f"'{word}' is no flag here: this is for the Go1, "
            f"or the robot of a recording or run ({ROBOTS_PAGE})"
        )
    if listed.get(word) and not own:
        return f"{word} is a flag of {', '.join(dict.fromkeys(listed[word]))}"
    hint = f": {nearest_hint(word, own or listed)}" if listed else ""
    return f"'{word}' is not understood{hint} (see --help)"
