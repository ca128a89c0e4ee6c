"""Worth of `saltus.tuning`: age of messages that are dated, work for each, pauses of the collector.

The heap takes hours: `saltus bench soak`; the scheduler a busy program:
    `tests/saltus/test_priority.py`.

    saltus bench tuning -- --repeats 20
"""

import gc
import multiprocessing
import subprocess
import sys
import threading
import time
from contextlib import closing
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks._command import Command
from saltus import tuning
from saltus.runtime.ticker import Ticker
from saltus.wire import zenoh_bus
from saltus.wire.codec import decode_message
from saltus.wire.messages import Done
from saltus.wire.router import open_router
from saltus.wire.zenoh_bus import ZenohBus

PREFIX = "bench"
LINKED_S = 1.0  # until peers have linked
SPAWN = multiprocessing.get_context("spawn")


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    messages: int = 1500
    """Small ones, at 200 Hz; ten times as many, at 5 kHz, where their work is measured."""
    repeats: int = 5
    """Repeats of each pause; of them the median counts."""

    def measure(self) -> dict[str, Any]:
        ways = {"without": False, "with": True}
        return {
            "switch_soon: age of a message that is dated beside a thread that computes, "
            "median [ms]": {
                way: round(_in_a_process(_late_ms, self.messages, 200.0, tuned), 2)
                for way, tuned in ways.items()
            },
            "keep_thread: work for each message [us]": {
                way: round(_in_a_process(_work_us, 10 * self.messages, 5000.0, tuned), 1)
                for way, tuned in ways.items()
            },
            "freeze: full collection in the controller's process [ms]": {
                way: round(_in_a_process(_pause_ms, self.repeats, 0.0, tuned), 2)
                for way, tuned in ways.items()
            },
        }


def _in_a_process(measure: Any, *arguments: Any) -> float:
    """Returns what a fresh process measures."""
    with SPAWN.Pool(1) as pool:
        return float(pool.apply(measure, arguments))


def _send(endpoint: str, count: int, rate_hz: float) -> None:
    ticker = Ticker(rate_hz)
    with ZenohBus(endpoint, PREFIX, peer=True) as bus:
        publisher = bus.publisher("done", "render")
        time.sleep(LINKED_S)
        for step in range(count):
            ticker.wait()
            publisher.put(Done(time_ns=time.monotonic_ns(), step=step, process="render"))
        time.sleep(LINKED_S)


def _sender(endpoint: str, count: int, rate_hz: float) -> threading.Thread:
    """A process that sends, as a thread that waits for it."""
    program = f"from benchmarks.tuning import _send; _send({endpoint!r}, {count}, {rate_hz})"
    thread = threading.Thread(
        target=subprocess.run, args=([sys.executable, "-c", program],), kwargs={"check": True}
    )
    thread.start()
    return thread


def _late_ms(count: int, rate_hz: float, is_tuned: bool) -> float:
    """Median age of messages when they are dated beside a thread that computes."""
    endpoint, router = open_router()
    as_is = tuning.switch_soon if is_tuned else lambda: lambda: None
    ages_ms: list[float] = []
    with (
        closing(router),
        patch.object(zenoh_bus, "switch_soon", as_is),
        ZenohBus(endpoint, PREFIX, peer=True) as bus,
    ):
        stream, sender = bus.stream(), _sender(endpoint, count, rate_hz)
        while sender.is_alive():
            sum(number * number for number in range(1_000_000))  # 0.1 s of plain Python
            heard = stream.drain()
            ages_ms += [
                1e-6 * (raw.arrival_ns - decode_message(Done, raw.payload).time_ns) for raw in heard
            ]
    return float(np.median(ages_ms))


def _work_us(count: int, rate_hz: float, is_tuned: bool) -> float:
    """Processor time of the receiver for each message."""
    endpoint, router = open_router()
    as_is = tuning.keep_thread if is_tuned else lambda: None
    with (
        closing(router),
        patch.object(zenoh_bus, "keep_thread", as_is),
        ZenohBus(endpoint, PREFIX, peer=True) as bus,
    ):
        latest, sender = bus.latest("done", "render"), _sender(endpoint, count, rate_hz)
        latest.wait(60.0)
        start_s = time.process_time()
        sender.join()
        return 1e6 * (time.process_time() - start_s) / count


def _pause_ms(repeats: int, _: float, is_tuned: bool) -> float:
    """Times a full collection of memory in a process that has loaded what the controller has."""
    import saltus.controller.__main__

    assert saltus.controller.__main__
    gc.collect()
    if is_tuned:
        tuning.freeze_garbage_collector()
    times_s = []
    for _ in range(repeats):
        start_s = time.perf_counter()
        gc.collect()
        times_s.append(time.perf_counter() - start_s)
    return 1e3 * float(np.median(times_s))
