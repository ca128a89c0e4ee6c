"""Kinds of flags and commands, and how they look in a help."""

from dataclasses import dataclass
from typing import Annotated, Protocol, TypeVar

import tyro

Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
"""A flag that is off unless it is given; it has no opposite."""

Command = TypeVar("Command")
Subcommands = Annotated[tyro.conf.OmitSubcommandPrefixes[Command], tyro.conf.arg(name="")]
"""The commands of a `CommandGroup`, a union of classes that are each annotated with
`tyro.conf.subcommand`."""


def flag_help(metavar: str, default: str) -> object:
    """Help of a flag that is None by default, for its annotation:
    what it takes, and what holds without it.
    """
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {default})")


AT_LEAST_ONE = tyro.conf.arg(metavar="PATH [PATH ...]", help_behavior_hint="(at least one)")
"""How the help shows a list of paths that must not be empty, which the command itself refuses."""


class Runnable(Protocol):
    """A command as a command line names it."""

    def run(self) -> int:
        """Does it; returns the exit code."""
        ...


@dataclass(frozen=True, kw_only=True)
class EndpointOption:
    """Flag of a command that joins a run."""

    endpoint: Annotated[str | None, flag_help("STR", "the one that the folder names")] = None
    """Zenoh router, e.g. tcp/127.0.0.1:7447."""


@dataclass(frozen=True, kw_only=True)
class CommandGroup:
    """A command that consists of others."""

    command: Runnable

    def run(self) -> int:
        """Runs the chosen one."""
        return self.command.run()
