"""Changes that processes of a run make to Python, the C library's heap and the scheduler.

Each is worth this, without it and with it:

| change | measured | without | with | by |
|---|---|---|---|---|
| `kept_small` | memory that stays, a process that dies, an hour | 0.1 to 2 MB | 1 MB | bench soak |
| `prefer_this_thread` (1) | loop's share of its time beside a busy program | 50 % | 96 % | test_priority.py |
| `switch_soon` | median age of a dated message (2) | 5.2 ms | 0.9 ms | bench tuning |
| `keep_thread` | work for each message that comes | 44 us | 34 us | bench tuning |
| `stand_back` | p99 of the ages of heights, by a page (3) | not measured | +4, +5 % | bench watch |
| `freeze_garbage_collector` | pause of a full collection, controller | 33 ms | 0 | bench tuning |

(1) with `prefer_process` and `prefer_loop`, on one core. (2) beside a thread that computes. (3) that
shows the run.
"""

import contextlib
import ctypes
import gc
import os
import platform
import struct
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

_M_ARENA_MAX = -8
"""glibc's malloc.h; mallopt(3)."""
GIVE_BACK_S = 30.0
"""How often what is free goes back.

Each time takes 0.3 to 2 ms, in which no other thread allocates.
"""
SWITCH_S = 5e-4
"""After which a thread of Python lets another one in; Python's own is 5 ms."""
PRIORITY = -10
"""Priority of a process of a run: before everything of ordinary priority."""
FIRST = {"controller": -15}
"""The 500 Hz loop comes before the others, and behind what the system keeps for itself."""
NICENESS = 10
"""Niceness of what is not part of a run or a training: a tenth of the share of a program of
ordinary priority (sched(7))."""
AUTOGROUP = Path("/proc/self/autogroup")
"""Where a session's priority is set (sched(7))."""
SLICE_NS = 100_000
"""The shortest that Linux takes [ns].

From 6.12 on, who has it and wakes up does not wait until a longer one ends.
"""
_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}
"""Number of the system call, which neither Python nor the C library has (Linux's syscall_64.tbl and
unistd.h)."""
_ATTRIBUTES = struct.Struct("<IIQiIQQQ")
"""sched_setattr(2): size, policy, flags, nice, priority, runtime, deadline, period. Of ordinary
programs, whose policy is 0, the runtime is the slice."""


def prefer_process(process: str) -> None:
    """Asks the scheduler to prefer this process, and the threads that it starts from now on.

    Short slices need no right: who wakes up every 4 ms for 0.8 ms, beside two busy programs on one
    processor, then waits 4 ms in the worst tenth of the cases, in place of 10. To come first in all
    else needs it (CAP_SYS_NICE).

    Linux shares processors among sessions first, and the supervisor starts every process in a
    session of its own: of six busy programs of ordinary priority each kept the threads of a camera
    waiting for up to 0.5 s.
    """
    _set_slices(SLICE_NS)
    if os.getsid(0) == os.getpid():
        with contextlib.suppress(OSError):  # no right to, or a kernel without groups of sessions
            AUTOGROUP.write_text(str(FIRST.get(process, PRIORITY)), encoding="utf-8")


def prefer_loop(process: str) -> None:
    """Puts the calling thread, a process's loop, before the threads of its libraries.

    Does nothing in processes that are not in `FIRST`, or without the right to (CAP_SYS_NICE).
    """
    if process in FIRST:
        with contextlib.suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, FIRST[process])


@contextlib.contextmanager
def prefer_this_thread() -> Iterator[None]:
    """Asks the scheduler to prefer the calling thread and those that it starts,
    while the block lasts.

    For the supervisor, which dates what it records: it shares a session with whatever else was
    started from the same shell, and so cannot use `prefer_process`.
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


def stand_back() -> None:
    """Lets programs of ordinary priority go before this process,
    which looks on or tries something out beside them.
    """
    os.nice(NICENESS)


def _set_slices(slice_ns: int) -> None:
    """Sets the slices of this thread and of those it starts; 0 for the usual ones.

    Older systems have none.
    """
    call = _SCHED_SETATTR.get(platform.machine()) if sys.platform == "linux" else None
    if call is None or os.sched_getscheduler(0) != os.SCHED_OTHER:
        return
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    attributes = _ATTRIBUTES.pack(_ATTRIBUTES.size, os.SCHED_OTHER, 0, nice, 0, slice_ns, 0, 0)
    ctypes.CDLL(None).syscall(call, 0, attributes, 0)


@contextlib.contextmanager
def kept_small() -> Iterator[None]:
    """Lets threads share one heap, and gives back what is free in it.

    Does nothing where the C library is not glibc.

    By default each thread that is started gets a heap of its own, and keeps what it gave back: a
    supervisor grew so by
    0.1 to 2 MB with every process that died, the others by 0.1 to 0.2 MB. And a heap is only cut at
    its end: messages that waited once to be recorded on a busy computer, 2 MB a second, were kept
    ever after (`saltus bench soak`). Threads share one heap for good; it is cut until the context
    ends.
    """
    try:
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_ARENA_MAX, 1)
        trim = libc.malloc_trim
    except (OSError, AttributeError):
        yield
        return
    ended = threading.Event()

    def give_back() -> None:
        while not ended.wait(GIVE_BACK_S):
            trim(0)  # outside of Python's lock

    thread = threading.Thread(target=give_back, name="memory", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def switch_soon() -> Callable[[], None]:
    """Lets other threads in soon, in a process that hears and dates everything: Zenoh's.

    What is returned undoes it.
    """
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    return lambda: sys.setswitchinterval(before_s)


_thread = threading.local()


def keep_thread() -> None:
    """Makes Python keep its state of the calling thread, one of Zenoh's, from one call to the next.

    It would map memory for a new one at each call and unmap it at its end.
    """
    if not hasattr(_thread, "kept"):
        _thread.kept = True
        ctypes.pythonapi.PyGILState_Ensure()  # never released


def freeze_garbage_collector() -> None:
    """Spares the collector what was loaded so far and lives on:
    it need not look at it in the middle of a tick.
    """
    gc.collect()
    gc.freeze()
