"""Processes of a real-time run come before those of ordinary priority, where they have the right to."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

PRIORITY = -10
"""Of a process of a run: before everything of ordinary priority."""
FIRST = {"controller": -15}
"""The 500 Hz loop comes before the others, and behind what the system keeps for itself."""
AUTOGROUP = Path("/proc/self/autogroup")
"""Where a session's priority is set (sched(7))."""


def prefer_process(process: str) -> None:
    """Asks the scheduler to prefer this process; without the right to (CAP_SYS_NICE) it takes its turn.

    Linux shares processors among sessions first, and the supervisor starts every process in a session of its own: of
    six busy programs of ordinary priority each kept the threads of a camera waiting for up to 0.5 s.
    """
    if os.getsid(0) == os.getpid():
        with contextlib.suppress(OSError):  # no right to, or a kernel without groups of sessions
            AUTOGROUP.write_text(str(FIRST.get(process, PRIORITY)))


def prefer_loop(process: str) -> None:
    """The same for the calling thread of a process whose loop comes before the threads of its libraries."""
    if process in FIRST:
        with contextlib.suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, FIRST[process])


@contextlib.contextmanager
def preferred() -> Iterator[None]:
    """The same for the calling thread and those that it starts, while the block lasts: for the supervisor.

    It dates what it records, and shares a session with whatever else was started from the same shell.
    """
    before = os.getpriority(os.PRIO_PROCESS, 0)
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, min(before, PRIORITY))
    try:
        yield
    finally:
        with contextlib.suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, before)
