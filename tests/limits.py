"""Limits of the system, lowered for a while."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from resource import RLIMIT_NOFILE, getrlimit, setrlimit


@contextmanager
def files_left(number: int) -> Iterator[None]:
    """This process can open so many more files; those that it has stay open."""
    # The lowest number that is free: a limit is one of numbers, not of how many there are
    free = os.dup(0)
    os.close(free)
    with file_numbers_below(free + number):
        yield


@contextmanager
def file_numbers_below(number: int) -> Iterator[None]:
    """Files that this process opens have lower numbers, as of `ulimit -n`."""
    soft, hard = getrlimit(RLIMIT_NOFILE)
    setrlimit(RLIMIT_NOFILE, (number, hard))
    try:
        yield
    finally:
        setrlimit(RLIMIT_NOFILE, (soft, hard))
