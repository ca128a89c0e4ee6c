"""The command `saltus`: its table of subcommands, and how errors look."""

import contextlib
import io
import re
import sys
from collections.abc import Sequence
from typing import Annotated

import tyro
from tyro.conf import subcommand

from saltus.cli.bench import Bench
from saltus.cli.controller import Controller
from saltus.cli.demo import Demo
from saltus.cli.doctor import Doctor
from saltus.cli.heightmap import Heightmap
from saltus.cli.policy import Policy
from saltus.cli.real2sim import Real2sim
from saltus.cli.record import Record
from saltus.cli.render import Render
from saltus.cli.replay import Replay
from saltus.cli.signals import Ended, ending_by_signals, raise_again
from saltus.cli.up import Up
from saltus.errors import SaltusError
from saltus.provenance import commit, package_version

Command = (
    Annotated[Demo, subcommand("demo")]
    | Annotated[Up, subcommand("up")]
    | Annotated[Doctor, subcommand("doctor")]
    | Annotated[Record, subcommand("record")]
    | Annotated[Replay, subcommand("replay")]
    | Annotated[Render, subcommand("render")]
    | Annotated[Heightmap, subcommand("heightmap")]
    | Annotated[Policy, subcommand("policy")]
    | Annotated[Controller, subcommand("controller")]
    | Annotated[Real2sim, subcommand("real2sim")]
    | Annotated[Bench, subcommand("bench")]
)

BAD_INPUT = 2
INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code: 0, 1 (it ran and failed), 2 (bad input), 130 (interrupted).

    SIGTERM and SIGHUP end it as Ctrl-C does, and then end this process by the same signal.
    """
    try:
        with ending_by_signals():
            return _run(sys.argv[1:] if arguments is None else arguments)
    except Ended as end:
        sys.stdout.flush()
        raise_again(end.number)
        return INTERRUPTED


def _run(arguments: Sequence[str]) -> int:
    try:
        if list(arguments) == ["--version"]:
            print(f"saltus {package_version('saltus')} ({commit()})")
            return 0
        command = _parse(arguments)
        _check_seeds(command)
        return command.run()
    except Ended:
        raise
    except SaltusError as error:
        print(f"saltus: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        sys.stdout = None  # the reader has left: there is nobody to tell
        return 1
    except OSError as error:
        if error.filename is None:
            raise  # nothing that a user has named
        print(f"saltus: cannot use '{error.filename}': {error.strerror}", file=sys.stderr)
        return BAD_INPUT


def _parse(arguments: Sequence[str]) -> Command:
    """Parses the command line; what tyro would print as a box becomes one line."""
    box = io.StringIO()
    try:
        with contextlib.redirect_stderr(box):
            return tyro.cli(
                Command,
                prog="saltus",
                description="A legged robot that sees where it steps.",
                args=arguments,
            )
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


if __name__ == "__main__":
    sys.exit(main())
