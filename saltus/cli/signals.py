"""SIGTERM and SIGHUP end a command as Ctrl-C does: what it holds is landed, closed and saved first."""

import contextlib
import os
import signal
from collections.abc import Iterator
from types import FrameType

from saltus.interrupts import WHOLE

ENDING = (signal.SIGTERM, signal.SIGHUP)
"""What service managers and containers send, and what a terminal sends that is closed."""


class Ended(KeyboardInterrupt):
    """One of these signals has come; whoever cleans up after Ctrl-C cleans up after it."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = signal.Signals(number)


@contextlib.contextmanager
def ending_by_signals() -> Iterator[None]:
    """Raises `Ended` for the first of these signals inside the block; more of them do not disturb the cleaning up.

    These and Ctrl-C wait for what `saltus.interrupts` says is to be done to its end.

    A signal that whoever started this process has told it to ignore, as `nohup` does, stays ignored. Outside of the
    main thread, where Python allows no handlers, nothing changes.
    """
    ended = False

    def handle(number: int, _: FrameType | None) -> None:
        nonlocal ended
        if not ended:
            ended = True
            WHOLE.interrupt(Ended(number))

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        WHOLE.interrupt(KeyboardInterrupt())

    before = {}
    with contextlib.suppress(ValueError):
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            before[signal.SIGINT] = signal.signal(signal.SIGINT, interrupt)
        for number in ENDING:
            if signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, handle)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def raise_again(number: signal.Signals) -> None:
    """Ends this process by a signal, so that whoever started it learns of it (a shell shows 128 + its number)."""
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)
