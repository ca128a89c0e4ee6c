"""How a process that has loaded waits until it is told to begin.

Loading takes up to a second on a free processor. So the supervisor has a spare process loaded,
which waits at `ProcessContext.ready`, or works along unheard from there on, and takes over as soon
as the first has died; and the controller loads beside the others, though the run begins with it.
The line is the standard input of the process, a socket: the process writes `LOADED`, and reads
`BEGIN` or, where the supervisor is gone, the end.
"""

import contextlib
import os
import select
from collections.abc import Callable

FLAG = "--await-cue"
IDLE, WORKING = "idle", "working"
"""How it waits: a process that works along hears all, and nobody hears it."""
LOADED = b"l"
BEGIN = b"b"
LOOK_S = 0.1  # how often it looks whether it was told to stop
_LINE = 0


def say_loaded() -> None:
    """Says that this process has loaded."""
    with contextlib.suppress(OSError):  # the supervisor is gone: so says the end of the line
        os.write(_LINE, LOADED)


def may_begin(wait_s: float = 0.0) -> bool | None:
    """True where it should begin: None while nothing has been said,
    False where the supervisor is gone.
    """
    if not select.select([_LINE], [], [], wait_s)[0]:
        return None
    with contextlib.suppress(ConnectionResetError):
        return os.read(_LINE, 1) == BEGIN
    return False


def await_cue(stopped: Callable[[], bool]) -> bool:
    """Says that this process has loaded, and waits.

    Returns whether it should begin, and was not told to stop.
    """
    say_loaded()
    while not stopped():
        begin = may_begin(LOOK_S)
        if begin is not None:
            return begin
    return False
