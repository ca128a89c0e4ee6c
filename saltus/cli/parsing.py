"""From the words of a command line to the dataclass that it stands for; what is wrong with them is one line."""

import contextlib
import io
import re
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import tyro

from saltus.errors import SaltusError, nearest_hint

BAD_INPUT = 2
ROBOTS_PAGE = "docs/robots.md says what takes another"
LARGEST_SEED = 2**63 - 1


def parse(kind: Any, arguments: Sequence[str] | None, *, prog: str, description: str | None) -> Any:
    """A dataclass, or one of a union of them, from a command line, by default that of this process.

    Where a command has a method `defaults`, its flags name which defaults hold, e.g. those of the training that it goes
    on from: the command line is then read once more with these.

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
    """The command with its method `defaults` applied, e.g. to the training that it resumes; None for others."""
    if hasattr(command, "defaults"):
        # The command line is read once more: a flag that it turns on would be turned off where it is the default.
        return replace(command.defaults(), **{f.name: False for f in fields(command) if f.default is False})
    inner = getattr(command, "command", None)
    found = None if inner is None else _defaults_of(inner)
    return None if found is None else replace(command, command=found)


def _read(kind: Any, arguments: Sequence[str] | None, prog: str, description: str | None, default: Any) -> Any:
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
    """Of the command, and of those that it holds: what numpy's generators and TOML both take."""
    for name, value in vars(command).items():
        if name in ("seed", "first_seed") and value is not None and not 0 <= value <= LARGEST_SEED:
            raise SaltusError(f"{name} = {value}: it must be from 0 to {LARGEST_SEED}")
        if name == "command":
            _check_seeds(value)


def _one_line(box: str) -> str:
    """What tyro's error box says, in the words of the other errors: the value, what is allowed, the nearest name."""
    lines = [re.sub(r"[│╭╮╰╯─]+|-{5,}", " ", line).strip() for line in box.splitlines()[1:]]
    text = re.sub(r"\s+", " ", " ".join(line for line in lines if line))
    if unknown := re.match(r"Unrecognized (?:or misplaced )?options: ([^\s,]+)", text):
        return _unknown(unknown[1], text)
    if missing := re.match(r"Missing from (.*?): (.*?) (?:Unrecognized|For full)", text):
        flags = re.findall(r"--[\w.-]+ (?=[A-Z])\S+", missing[2])
        return f"{missing[1]} needs {' and '.join(flags) or missing[2]}"
    if choice := re.match(r"invalid choice '(.*?)' for argument '(.*?)'. Expected one of \((.*?)\)", text):
        return f"{choice[2]} {choice[1]}: " + nearest_hint(choice[1], re.findall(r"'(.*?)'", choice[3]))
    if wrong := re.match(r"Error parsing (\S+): .*?(?:\[(.*?)\]|: '(.*?)' )", text):
        flag, value = wrong[1], wrong[3] or wrong[2].replace("'", "").replace(",", "")
        kind = re.search(rf"helptext: (?:{re.escape(flag)} )?((?:[A-Z{{][^a-z\s]* )+)", f"{text} ")
        return f"{flag} {value}: it must be {kind[1].strip() if kind else 'another value'}"
    return text.split(" For full helptext")[0]


def _unknown(word: str, text: str) -> str:
    """What cannot be understood, and what is like it among what tyro lists."""
    if commands := re.search(r"Available subcommands: (.*?) (?:Perhaps|Arguments similar|For full)", text):
        known = [*commands[1].split(", "), "--help", "--version", "--completion"]
        return f"there is no command '{word}': {nearest_hint(word, known)}"
    entries = re.split(r" (?=--[a-z][\w.-]* [A-Z{\[])", text.split(" For full")[0])[1:]
    commands_of = {entry.split()[0]: re.findall(r"in (saltus .*?) --help", entry) for entry in reversed(entries)}
    asked = re.search(r"\(applied to (.*?)\)", text)
    own = {flag for flag, commands in commands_of.items() if asked and asked[1] in commands}
    if word == "--robot" and "--robots" not in own:
        return f"'{word}' is no flag here: this is for the Go1, or the robot of a recording or run ({ROBOTS_PAGE})"
    if commands_of.get(word) and not own:
        return f"{word} is a flag of {', '.join(commands_of[word])}"
    flags = own or set(commands_of)
    return f"'{word}' is not understood{f': {nearest_hint(word, flags)}' if flags else ''} (see --help)"
