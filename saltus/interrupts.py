"""Signals wait for work that they would tear apart:
Python runs their handlers between any two steps of a program.

A message of which a recording has the first half makes the rest of that part of the file
unreadable.
"""

import threading
from types import TracebackType


class _Whole:
    """Work of the main thread that is done to its end, as a context manager.

    It may be entered again inside.
    """

    def __init__(self) -> None:
        self._depth = 0
        self._late: BaseException | None = None

    def __enter__(self) -> None:
        if threading.current_thread() is threading.main_thread():
            self._depth += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        if threading.current_thread() is not threading.main_thread():
            return  # no signal's handler runs there
        self._depth -= 1
        if self._depth == 0 and self._late is not None:
            late, self._late = self._late, None
            raise late

    def interrupt(self, error: BaseException) -> None:
        """Raises an error in a signal's handler:
        now, or when the work that is under way is done.
        """
        if self._depth == 0:
            raise error
        self._late = self._late or error


WHOLE = _Whole()
