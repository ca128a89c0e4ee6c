"""The memory of a process that shall run for days."""

import contextlib
import ctypes

_M_ARENA_MAX = -8
"""glibc's malloc.h; mallopt(3)."""


def use_one_heap() -> None:
    """Lets all threads that are started from now on allocate from one heap, where the C library is glibc.

    By default each gets one of its own, and keeps what it gave back. A supervisor grew so by 0.1 to 2 MB with every
    process that died, the others by 0.1 to 0.2 MB (`saltus bench soak`).
    """
    with contextlib.suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)
