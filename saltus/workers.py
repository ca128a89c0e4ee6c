"""Processes that share the batches of a round and end with whoever started them."""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.connection import Connection
from typing import TypeVar

from saltus.errors import ConfigError

Task = TypeVar("Task")
Result = TypeVar("Result")


MOST_PROCESSES = 4096  # twice as many cores as the largest computers have
WorkerListener = Callable[[float], None]
"""Told how much further a task is, in whatever unit."""
_listener: list[WorkerListener] = []
"""Listener of this process: none, or the one that `tell_progress` tells."""


def tell_progress(amount: float) -> None:
    """Tells whoever waits for the task that calls this how much further it is.

    Does nothing where nobody listens.
    """
    for listener in _listener:
        listener(amount)


def in_order(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    processes: int | None = None,
    listener: WorkerListener | None = None,
) -> Generator[Result, None, None]:
    """Yields `function` of each task, in the order of the tasks.

    Several processes run ahead, by one task each.

    When the iteration is left early, or this process dies in whatever way, the processes end at
    once.

    Args:
        function: Can be sent to another process where `processes` is not 1.
        tasks: Its arguments.
        processes: How many; one for each core if it is not stated. 1 runs everything here.
        listener: Gets what tasks `tell_progress`, in a thread of its own.

    Raises:
        ConfigError: see `check_processes`.
    """
    check_processes(processes)
    if processes is None:
        processes = len(os.sched_getaffinity(0))
    if processes == 1 or len(tasks) <= 1:
        with _listening(listener):
            yield from map(function, tasks)
        return
    context = multiprocessing.get_context("spawn")
    lifeline, held = context.Pipe(duplex=False)
    # Without a lock, which a process that ends at once could hold for ever
    ear, mouth = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(
        processes, mp_context=context, initializer=_begin, initargs=(lifeline, mouth)
    )
    listening = threading.Thread(target=_pass_on, args=(ear, listener), daemon=True)
    listening.start()
    try:
        waiting = [pool.submit(function, task) for task in tasks[: 2 * processes]]
        for following in range(len(waiting), len(tasks) + len(waiting)):
            if not waiting:
                return
            result = waiting.pop(0).result()
            if following < len(tasks):
                waiting.append(pool.submit(function, tasks[following]))
            yield result
    finally:
        held.close()
        pool.shutdown(cancel_futures=True)
        mouth.close()
        listening.join()


def check_processes(processes: int | None) -> None:
    """Raises `ConfigError` for a number of processes that is not from 1 to `MOST_PROCESSES`."""
    if processes is not None and not 1 <= processes <= MOST_PROCESSES:
        raise ConfigError(f"processes = {processes}: it must be from 1 to {MOST_PROCESSES}")


@contextlib.contextmanager
def _listening(listener: WorkerListener | None) -> Iterator[None]:
    _listener[:] = [listener] if listener else []
    try:
        yield
    finally:
        _listener.clear()


def _pass_on(ear: Connection, listener: WorkerListener | None) -> None:
    """Until the last of those who tell something is gone."""
    with contextlib.suppress(EOFError):
        while True:
            amount: float = ear.recv()
            if listener is not None:
                listener(amount)


def _begin(lifeline: Connection, mouth: Connection) -> None:
    """Before a process's first task: an interruption is the business of the one who started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _listener[:] = [mouth.send]
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    """Waits for the end of the pipe, whose other end only the parent holds,
    and ends this process in mid-work.
    """
    lifeline.poll(None)
    os._exit(1)
