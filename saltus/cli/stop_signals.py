"""SIGTERM and SIGHUP end a command as Ctrl-C does:
what it holds is landed, closed and saved first.
"""

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from types import FrameType

from saltus.interrupts import WHOLE

ENDING = (signal.SIGTERM, signal.SIGHUP)
"""Signals that service managers, containers and closed terminals send."""


AGAIN_S, AT_MOST_S = 0.02, 10.0
"""How soon is looked again whether modules are still being imported, and how long that is waited
for."""
_IMPORT = "<frozen importlib._bootstrap>"


class Ended(KeyboardInterrupt):
    """Raised when a signal has come that ends this program; whoever cleans up after Ctrl-C cleans
    up after it.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = signal.Signals(number)


@contextlib.contextmanager
def ending_by_signals() -> Iterator[None]:
    """Raises `Ended` for the first of these signals inside the block.

    More of them do not disturb the cleaning up.

    A block that catches it and goes on to its end raises it there.

    These and Ctrl-C wait for what `saltus.interrupts` says is to be done to its end, and for
    modules that are being imported: an interruption within the start of a compiled module comes out
    as an error of the import.

    A signal that whoever started this process has told it to ignore, as `nohup` does, stays
    ignored. Outside of the main thread, where Python allows no handlers, nothing changes.
    """
    ended: Ended | None = None
    waits = _Waits()

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal ended
        if ended is None:
            ended = Ended(number)
            waits.interrupt(ended, frame)

    def interrupt(_number: int, frame: FrameType | None) -> None:
        waits.interrupt(KeyboardInterrupt(), frame)

    before = {}
    with contextlib.suppress(ValueError):
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            before[signal.SIGINT] = signal.signal(signal.SIGINT, interrupt)
        before[signal.SIGALRM] = signal.signal(signal.SIGALRM, waits.again)
        for number in ENDING:
            if signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, handle)
    try:
        yield
        waits.end()
        if (
            ended is not None
        ):  # what the block ended by itself, as a collection that keeps its batches
            raise ended
    finally:
        if signal.SIGALRM in before:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)


class _Waits:
    """Interruptions that wait until nothing is being imported; a timer looks again."""

    def __init__(self) -> None:
        self._late: BaseException | None = None
        self._since_s = 0.0

    def interrupt(self, error: BaseException, frame: FrameType | None) -> None:
        """Raises now, or later."""
        if not _is_importing(frame):
            WHOLE.interrupt(error)
        elif self._late is None:
            self._late, self._since_s = error, time.monotonic()
            signal.setitimer(signal.ITIMER_REAL, AGAIN_S)

    def again(self, _number: int, frame: FrameType | None) -> None:
        """The handler of the timer."""
        if self._late is None:
            return
        if _is_importing(frame) and time.monotonic() - self._since_s < AT_MOST_S:
            signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
        else:
            late, self._late = self._late, None
            WHOLE.interrupt(late)

    def end(self) -> None:
        """Raises now a signal that has come and was not raised."""
        if self._late is not None:
            late, self._late = self._late, None
            raise late


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == _IMPORT:
            return True
        frame = frame.f_back
    return False


def raise_again(number: signal.Signals) -> None:
    """Ends this process by a signal, so that whoever started it learns
    of it (a shell shows 128 + its number).
    """
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)
