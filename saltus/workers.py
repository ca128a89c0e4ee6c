"""Processes that share the batches of a round and end with whoever started them."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.connection import Connection
from typing import TypeVar

from saltus.errors import ConfigError

Task = TypeVar("Task")
Result = TypeVar("Result")


def in_order(
    function: Callable[[Task], Result], tasks: Sequence[Task], processes: int | None = None
) -> Generator[Result, None, None]:
    """Yields `function` of each task, in the order of the tasks; several processes run ahead, by one task each.

    When the iteration is left early, or this process dies in whatever way, the processes end at once.

    Args:
        function: Can be sent to another process where `processes` is not 1.
        tasks: Its arguments.
        processes: How many; one for each core where it is not given. 1 runs everything here.

    Raises:
        ConfigError: not even one process.
    """
    if processes is None:
        processes = len(os.sched_getaffinity(0))
    if processes < 1:
        raise ConfigError(f"processes = {processes}: it must be at least 1")
    if processes == 1 or len(tasks) <= 1:
        yield from map(function, tasks)
        return
    context = multiprocessing.get_context("spawn")
    lifeline, held = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(processes, mp_context=context, initializer=_begin, initargs=(lifeline,))
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


def _begin(lifeline: Connection) -> None:
    """Before a process's first task: an interruption is the business of the one who started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    """Waits for the end of the pipe, whose other end only the parent holds, and ends this process in mid-work."""
    lifeline.poll(None)
    os._exit(1)
