"""The memory of a process that shall run for days."""

import contextlib
import ctypes
import threading
from collections.abc import Iterator

_M_ARENA_MAX = -8
"""glibc's malloc.h; mallopt(3)."""
GIVE_BACK_S = 30.0
"""How often what is free goes back; each time takes 0.3 to 2 ms, in which no other thread allocates."""


@contextlib.contextmanager
def kept_small() -> Iterator[None]:
    """Lets threads share one heap, and gives back what is free in it; does nothing where the C library is not glibc.

    By default each thread that is started gets a heap of its own, and keeps what it gave back: a supervisor grew so by
    0.1 to 2 MB with every process that died, the others by 0.1 to 0.2 MB. And a heap is only cut at its end: messages
    that waited once to be recorded on a busy computer, 2 MB a second, were kept ever after (`saltus bench soak`).
    Threads share one heap for good; it is cut until the context ends.
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
