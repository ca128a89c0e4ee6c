"""The command `saltus`: its table of subcommands, and how errors look."""

import errno
import sys
from collections.abc import Sequence
from typing import Annotated

from tyro.conf import subcommand

from saltus.cli.bench import Bench
from saltus.cli.camera import Camera
from saltus.cli.controller import Controller
from saltus.cli.demo import Demo
from saltus.cli.doctor import Doctor
from saltus.cli.heightmap import Heightmap
from saltus.cli.keys import Keys
from saltus.cli.parsing import BAD_INPUT, parse
from saltus.cli.policy import Policy
from saltus.cli.real2sim import Real2sim
from saltus.cli.record import Record
from saltus.cli.render import Render
from saltus.cli.replay import Replay
from saltus.cli.robot import RobotCommand
from saltus.cli.router import Router
from saltus.cli.signals import Ended, ending_by_signals, raise_again
from saltus.cli.up import Up
from saltus.cli.watch import Watch
from saltus.errors import SaltusError
from saltus.provenance import commit, package_version

Command = (
    Demo
    | Up
    | Watch
    | Router
    | Keys
    | Doctor
    | Record
    | Replay
    | Camera
    | Render
    | Heightmap
    | Policy
    | Controller
    | Real2sim
    | Annotated[RobotCommand, subcommand("robot")]
    | Bench
)

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
        return command_of(arguments).run()
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
        if error.errno == errno.ENOSPC:
            print("saltus: no space is left on the disk", file=sys.stderr)
            return BAD_INPUT
        if error.filename is None:
            raise  # nothing that a user has named
        print(f"saltus: cannot use '{error.filename}': {error.strerror}", file=sys.stderr)
        return BAD_INPUT


def command_of(arguments: Sequence[str]) -> Command:
    """What is to be run; what follows the name of a benchmark is for that benchmark to read."""
    if arguments[:1] == ["bench"] and len(arguments) > 1 and not arguments[1].startswith("-"):
        return Bench(name=arguments[1], arguments=tuple(arguments[2:]))
    command: Command = parse(Command, arguments, prog="saltus", description="A legged robot that sees where it steps.")
    return command


if __name__ == "__main__":
    sys.exit(main())
