"""Processes of a real-time run wake up soon on a busy computer, and come before others where they have the right to."""

import contextlib
import ctypes
import os
import platform
import struct
import sys
from collections.abc import Iterator
from pathlib import Path

PRIORITY = -10
"""Priority of a process of a run: before everything of ordinary priority."""
FIRST = {"controller": -15}
"""The 500 Hz loop comes before the others, and behind what the system keeps for itself."""
AUTOGROUP = Path("/proc/self/autogroup")
"""Where a session's priority is set (sched(7))."""
SLICE_NS = 100_000
"""The shortest that Linux takes [ns]. From 6.12 on, who has it and wakes up does not wait until a longer one ends."""
_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}
"""Number of the system call, which neither Python nor the C library has (Linux's syscall_64.tbl and unistd.h)."""
_ATTRIBUTES = struct.Struct("<IIQiIQQQ")
"""sched_setattr(2): size, policy, flags, nice, priority, runtime, deadline, period. Of ordinary programs, whose policy
is 0, the runtime is the slice."""


def prefer_process(process: str) -> None:
    """Asks the scheduler to prefer this process, and the threads that it starts from now on.

    Short slices need no right: who wakes up every 4 ms for 0.8 ms, beside two busy programs on one processor, then
    waits 4 ms in the worst tenth of the cases, in place of 10. To come first in all else needs it (CAP_SYS_NICE).

    Linux shares processors among sessions first, and the supervisor starts every process in a session of its own: of
    six busy programs of ordinary priority each kept the threads of a camera waiting for up to 0.5 s.
    """
    _set_slices(SLICE_NS)
    if os.getsid(0) == os.getpid():
        with contextlib.suppress(OSError):  # no right to, or a kernel without groups of sessions
            AUTOGROUP.write_text(str(FIRST.get(process, PRIORITY)), encoding="utf-8")


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
    _set_slices(SLICE_NS)
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, min(before, PRIORITY))
    try:
        yield
    finally:
        _set_slices(0)
        with contextlib.suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, before)


def _set_slices(slice_ns: int) -> None:
    """Sets the slices of this thread and of those it starts; 0 for the usual ones. Older systems have none."""
    call = _SCHED_SETATTR.get(platform.machine()) if sys.platform == "linux" else None
    if call is None or os.sched_getscheduler(0) != os.SCHED_OTHER:
        return
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    attributes = _ATTRIBUTES.pack(_ATTRIBUTES.size, os.SCHED_OTHER, 0, nice, 0, slice_ns, 0, 0)
    ctypes.CDLL(None).syscall(call, 0, attributes, 0)
