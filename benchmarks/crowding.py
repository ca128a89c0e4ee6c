"""What a run does beside others that take its time: its heightmap service starved, and floods of messages on its keys.

starved: the service stands still for four fifths of each 100 ms. flood: another program of the run's owner sends
messages of 20 kB on a key, as fast as it can, up to 10,000 a second; none is of the key's type.

    saltus bench crowding -- --trials 5
    saltus bench crowding -- --trials 5 --speed 0.25
"""

import contextlib
import multiprocessing
import os
import signal
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from benchmarks._command import Command, progress, tell
from saltus.config import RunConfig, TerrainConfig
from saltus.errors import StackError
from saltus.recordings.recording import Recording, read_recording
from saltus.runtime.faults import SILENT_S, end_of, stale_uses, wait_until_running
from saltus.runtime.run_folder import CLIENT_FILE
from saltus.runtime.stack import Stack
from saltus.wire.messages import RobotState

BEFORE_S, DURING_S, AFTER_S = 0.5, 2.0, 2.0
PERIOD_S, SHARE = 0.1, 0.2  # of a quota as the kernel gives it
FLOOD_HZ, FLOOD_BYTES = 10_000, 20_000
KEYS = ("camera/depth", "heightmap/heightmap", "policy/plan", "controller/state", "status/flood")
SPAWN = multiprocessing.get_context("spawn")
Disturbance = Callable[[Stack], "contextlib.AbstractContextManager[None]"]


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    trials: int = 3
    """Of each kind."""
    seed: int = 0
    """Of the moments at which it begins."""
    speed: float = 1.0
    """Of the run's clock."""

    def measure(self) -> dict[str, Any]:
        floods = {f"flood on {key}": Flood(key) for key in KEYS}
        kinds: dict[str, Disturbance] = {"nothing": lambda _: contextlib.nullcontext(), "starved": self._starved}
        kinds.update(floods)
        table: dict[str, Any] = {}
        for name, disturb in kinds.items():
            rows = [self._trial(disturb, number) for number in progress(range(self.trials), name)]
            flood = floods.get(name)
            table[name] = {
                "ends": dict(Counter(row["end"] for row in rows)),
                "stale": sum(row["stale"] for row in rows),
                "state_gap_ms_p99": max(row["state_gap_ms_p99"] for row in rows),
                **({} if flood is None else {"sent_hz": flood.sent / max(1e-9, flood.lasted_s)}),
            }
            tell(f"{name}: {table[name]}")
        return {"crowding": table}

    def _trial(self, disturb: Disturbance, number: int) -> dict[str, Any]:
        after_s = BEFORE_S + float(np.random.default_rng([self.seed, number]).uniform(0.0, 0.5))
        config = RunConfig(
            terrain=TerrainConfig(terrain="flat"), pace="realtime", planner="scripted", speed=self.speed, seed=number
        )
        with tempfile.TemporaryDirectory() as folder:
            with Stack(config, Path(folder)) as stack:
                states = stack.latest("controller/state")
                wait_until_running(stack, states)
                stack.wait(after_s)
                sample = states.wait(SILENT_S)
                if sample is None:
                    raise StackError("the robot has gone before it was disturbed")
                with disturb(stack):
                    over = stack.wait(DURING_S)
                if not over:
                    stack.wait(AFTER_S)
            return judged(read_recording(Path(folder) / "recording.mcap"), sample.message.time_ns)

    @contextlib.contextmanager
    def _starved(self, stack: Stack) -> Iterator[None]:
        pid, over = stack.pid("heightmap"), threading.Event()

        def starve() -> None:
            while not over.is_set():
                os.kill(pid, signal.SIGSTOP)
                time.sleep((1.0 - SHARE) * PERIOD_S / self.speed)
                os.kill(pid, signal.SIGCONT)
                time.sleep(SHARE * PERIOD_S / self.speed)

        thread = threading.Thread(target=starve)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()


class Flood:
    """Another process that sends on a key of a run; `sent` messages in `lasted_s` seconds, of all runs."""

    def __init__(self, key: str) -> None:
        self.key, self.sent, self.lasted_s = key, 0, 0.0

    @contextlib.contextmanager
    def __call__(self, stack: Stack) -> Iterator[None]:
        over, sent = SPAWN.Event(), SPAWN.Value("q", 0)
        key = f"{stack.config.prefix}/{self.key}"
        process = SPAWN.Process(target=flood, args=(stack.run_dir / CLIENT_FILE, key, over, sent))
        process.start()
        while sent.value == 0:
            if not process.is_alive():
                raise StackError(f"nothing could be sent on {key}")
            stack.wait(0.01)
        begun_s = time.monotonic()
        try:
            yield
        finally:
            over.set()
            process.join()
            self.sent += sent.value
            self.lasted_s += time.monotonic() - begun_s


def flood(client: Path, key: str, over: Any, sent: "Synchronized[int]") -> None:
    """Sends on a key, as a program whose Zenoh configuration is `client`, until `over` is set; `sent` counts."""
    payload, attachment = os.urandom(FLOOD_BYTES), bytes(40)
    with zenoh.open(zenoh.Config.from_file(str(client))) as session:
        publisher = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP, express=True)
        next_s = time.monotonic()
        while not over.is_set():
            publisher.put(payload, attachment=attachment)
            sent.value += 1
            next_s = max(next_s + 1.0 / FLOOD_HZ, time.monotonic() - 0.01)
            time.sleep(max(0.0, next_s - time.monotonic()))


def judged(recording: Recording, begin_ns: int) -> dict[str, Any]:
    """How a robot that was disturbed from some moment on [run's clock] fared."""
    times_ns = np.array([state.time_ns for state in recording.of(RobotState)])
    during = times_ns[(times_ns > begin_ns) & (times_ns < begin_ns + 1e9 * DURING_S)]
    return {
        "end": end_of(recording),
        "stale": stale_uses(recording),
        "state_gap_ms_p99": float(np.percentile(1e-6 * np.diff(during), 99)) if len(during) > 1 else float("inf"),
    }
