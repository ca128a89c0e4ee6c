"""The command `saltus`: its table of subcommands, and how errors look."""

import ast
import errno
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import reduce
from importlib import import_module
from io import TextIOWrapper
from operator import or_
from pathlib import Path
from typing import Annotated, Any, cast

from tyro.conf import subcommand

from saltus.cli.parsing import BAD_INPUT, parse
from saltus.cli.stop_signals import Ended, ending_by_signals, raise_again
from saltus.errors import SaltusError
from saltus.flags import Runnable

COMMANDS = {
    "demo": "Demo",
    "up": "Up",
    "drive": "Drive",
    "watch": "Watch",
    "router": "Router",
    "keys": "KeysCommands",
    "doctor": "Doctor",
    "ros2": "Ros2",
    "record": "RecordCommands",
    "replay": "Replay",
    "camera": "CameraCommands",
    "render": "RenderCommands",
    "heightmap": "HeightmapCommands",
    "policy": "PolicyCommands",
    "controller": "Controller",
    "real2sim": "Real2simCommands",
    "robot": "RobotCommands",
    "terrain": "TerrainCommand",
    "paper": "PaperCommand",
    "bench": "Bench",
}
"""The class of each command, in the module of `saltus.cli` that has its name.

Only the one that is run is imported.
"""

INTERRUPTED = 130
MUJOCO_GL = (
    "",
    "glfw",
    "glx",
    "egl",
    "osmesa",
    "on",
    "enable",
    "enabled",
    "true",
    "1",
    "off",
    "disable",
    "disabled",
    "false",
    "0",
)
"""Values of this variable of the environment that MuJoCo knows (its
mujoco/rendering/classic/gl_context.py)."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code:
    0, 1 (it ran and failed), 2 (bad input), 130 (interrupted).

    SIGTERM and SIGHUP end it as Ctrl-C does, and then end this process by the same signal.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without a sign shows "?" in its place
    try:
        with ending_by_signals():
            return _run(sys.argv[1:] if arguments is None else arguments)
    except Ended as end:
        if sys.stdout is not None:  # None where its reader has left, too
            sys.stdout.flush()
        raise_again(end.number)
        return INTERRUPTED


def _run(arguments: Sequence[str]) -> int:
    try:
        # Before numpy and torch are imported, which start a thread for each core. Where another
        # program has the core of one, the others wait for it in a loop, which takes many times as
        # long (benchmarks/README.md). Torch's can sleep meanwhile; numpy's cannot, and save nothing
        # on idle cores.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        os.environ.setdefault("OMP_WAIT_POLICY", "passive")
        # Before tqdm is imported: a file gets a bar every ten seconds in place of ten a second.
        if sys.stderr is None or not sys.stderr.isatty():
            os.environ.setdefault("TQDM_MININTERVAL", "10")
        _ask_for_mujoco_gl()
        if list(arguments) == ["--version"]:
            from saltus.provenance import current_commit, package_version

            print(f"saltus {package_version('saltus')} ({current_commit()})")
            return 0
        if arguments[:1] == ["--completion"]:
            from saltus.cli.completion import completion_script

            print(completion_script(_union(_imported), " ".join(arguments[1:])))
            return 0
        return command_of(arguments).run()
    except Ended:
        raise
    except SaltusError as error:
        print(f"saltus: {error}", file=sys.stderr)
        return BAD_INPUT
    except ModuleNotFoundError as error:
        package = (error.name or "").split(".")[0]
        if package in ("", "saltus"):
            raise  # a fault of ours, not of the installation
        hint = "pip install saltus (saltus doctor says what else is missing)"
        print(
            f"saltus: this needs the package '{package}', which is not installed: {hint}",
            file=sys.stderr,
        )
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


def _ask_for_mujoco_gl() -> None:
    """Refuses a value at which MuJoCo fails, and turns off what Saltus does not draw with.

    The engine would look for that library when it is imported; not every installation has it.
    """
    told = os.environ.get("MUJOCO_GL", "")
    if told.lower().strip() not in MUJOCO_GL:
        allowed = ", ".join(filter(None, MUJOCO_GL))
        raise SaltusError(
            f"MUJOCO_GL = {told}: MuJoCo takes {allowed}; unset it, Saltus does not need it"
        )
    os.environ["MUJOCO_GL"] = "off"


def command_of(arguments: Sequence[str]) -> Runnable:
    """The command to run; the words after the name of a benchmark are for that benchmark to read.

    Raises:
        SaltusError: no command line of Saltus.
    """
    name, *words = arguments or [""]
    if name in COMMANDS:
        kind = _imported(name)
        if name == "bench" and words and not words[0].startswith("-"):
            return cast(Runnable, kind(name=words[0], arguments=tuple(words[1:])))
        if name == "paper":
            return cast(Runnable, kind(arguments=tuple(words)).read())
        with suppress(SaltusError):  # which is told below, with what the other commands take
            return cast(Runnable, parse(kind, words, prog=f"saltus {name}", description=None))
    union = _union(_described if name in ("-h", "--help") else _imported)
    return cast(
        Runnable,
        parse(
            union, arguments, prog="saltus", description="A legged robot that sees where it steps."
        ),
    )


def _union(kinds: Callable[[str], type]) -> Any:
    """All commands, each by the class that `kinds` makes of its name."""
    return reduce(or_, [Annotated[kinds(name), subcommand(name)] for name in COMMANDS])


def _imported(name: str) -> type:
    """The class of a command."""
    kind: type = getattr(import_module(f"saltus.cli.{name}"), COMMANDS[name])
    return kind


def _described(name: str) -> type:
    """A stand-in for it that says the same in its first sentence,
    without what running it would import.
    """
    source = ast.parse(Path(__file__).with_name(f"{name}.py").read_text(encoding="utf-8"))
    (found,) = (
        node
        for node in source.body
        if isinstance(node, ast.ClassDef) and node.name == COMMANDS[name]
    )
    return dataclass(type(name, (), {"__doc__": (ast.get_docstring(found) or "").split("\n\n")[0]}))


if __name__ == "__main__":
    sys.exit(main())
