"""Runs beside others that take their time: a service starved,
floods of messages, strangers who connect.

starved: the service stands still for four fifths of each 100 ms. flood: another program of the
    run's owner sends
messages of 20 kB on a key, as fast as it can, up to 10,000 a second; none is of the key's type.
strangers: the run listens for who has a certificate (`saltus up --listen`), and another program
without one connects as often as it can; it says nothing and stays, or begins TLS and is refused.
The supervisor may open 1,024 files, as is usual.

    saltus bench crowding -- --trials 5
    saltus bench crowding -- --trials 5 --speed 0.25
"""

import contextlib
import multiprocessing
import os
import resource
import signal
import socket
import ssl
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from benchmarks._command import Command, progress, tell
from benchmarks._judgement import end_of, stale_uses
from benchmarks._kills import ON_FLAT_GROUND, SILENT_S, wait_until_running
from saltus.errors import StackError
from saltus.recordings.recording import Recording, read_recording
from saltus.runtime.run_folder import CLIENT_FILE
from saltus.runtime.stack import Stack
from saltus.wire.certificates import create_authority, network_of
from saltus.wire.messages import RobotState

BEFORE_S, DURING_S, AFTER_S = 0.5, 2.0, 2.0
PERIOD_S, SHARE = 0.1, 0.2  # of a quota as the kernel gives it
FLOOD_HZ, FLOOD_BYTES = 10_000, 20_000
KEYS = ("camera/depth", "heightmap/heightmap", "policy/plan", "controller/state", "status/flood")
CONNECTIONS, FILES = 2000, 1024
SPAWN = multiprocessing.get_context("spawn")
Address = tuple[str, int]
Disturbance = Callable[[Stack, Address], "contextlib.AbstractContextManager[None]"]


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    trials: int = 3
    """Trials of each kind."""
    seed: int = 0
    """Seed of the moments at which it begins."""
    speed: float = 1.0
    """Speed of the run's clock."""

    def measure(self) -> dict[str, Any]:
        limit_files(FILES)
        others = {f"flood on {key}": Other(flood, partial(own_key, key)) for key in KEYS}
        others |= {
            name: Other(act, lambda _, address: (address,)) for name, act in STRANGERS.items()
        }
        kinds: dict[str, Disturbance] = {
            "nothing": lambda *_: contextlib.nullcontext(),
            "starved": self._starved,
        }
        kinds.update(others)
        table: dict[str, Any] = {}
        for name, disturb in kinds.items():
            rows = [self._trial(disturb, number) for number in progress(range(self.trials), name)]
            other = others.get(name)
            table[name] = {
                "ends": dict(Counter(row["end"] for row in rows)),
                "stale": sum(row["stale"] for row in rows),
                "state_gap_ms_p99": max(row["state_gap_ms_p99"] for row in rows),
                **({} if other is None else {"sent_hz": other.sent / max(1e-9, other.lasted_s)}),
            }
            tell(f"{name}: {table[name]}")
        return {"crowding": table}

    def _trial(self, disturb: Disturbance, number: int) -> dict[str, Any]:
        after_s = BEFORE_S + float(np.random.default_rng([self.seed, number]).uniform(0.0, 0.5))
        config = replace(ON_FLAT_GROUND, speed=self.speed, seed=number)
        with tempfile.TemporaryDirectory() as folder:
            host, port = address = free_address()
            create_authority(Path(folder) / "keys", f"{host}:{port}", days=1)
            network = network_of(Path(folder) / "keys", f"{host}:{port}", config.prefix)
            with Stack(config, Path(folder), network=network) as stack:
                states = stack.latest("controller/state")
                wait_until_running(stack, states)
                stack.wait(after_s)
                sample = states.wait(SILENT_S)
                if sample is None:
                    raise StackError("the robot has gone before it was disturbed")
                with disturb(stack, address):
                    over = stack.wait(DURING_S)
                if not over:
                    stack.wait(AFTER_S)
            return judged(read_recording(Path(folder) / "recording.mcap"), sample.message.time_ns)

    @contextlib.contextmanager
    def _starved(self, stack: Stack, _: Address) -> Iterator[None]:
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


class Other:
    """Another process that keeps a run busy.

    What it did, `sent` times in `lasted_s` seconds, of all runs.
    """

    def __init__(
        self, act: Callable[..., None], where: Callable[[Stack, Address], tuple[Any, ...]]
    ) -> None:
        self.sent, self.lasted_s = 0, 0.0
        self._act, self._where = act, where

    @contextlib.contextmanager
    def __call__(self, stack: Stack, address: Address) -> Iterator[None]:
        over, sent = SPAWN.Event(), SPAWN.Value("q", 0)
        process = SPAWN.Process(target=self._act, args=(*self._where(stack, address), over, sent))
        process.start()
        while sent.value == 0:
            if not process.is_alive():
                raise StackError(f"{self._act.__name__} did nothing")
            stack.wait(0.01)
        begun_s = time.monotonic()
        try:
            yield
        finally:
            over.set()
            process.join()
            self.sent += sent.value
            self.lasted_s += time.monotonic() - begun_s


def own_key(key: str, stack: Stack, _: Address) -> tuple[Path, str]:
    """Returns what a program of the run's owner needs to send on a key of the run."""
    return stack.run_dir / CLIENT_FILE, f"{stack.config.prefix}/{key}"


def flood(client: Path, key: str, over: Any, sent: "Synchronized[int]") -> None:
    """Sends on a key, as a program whose Zenoh configuration is `client`,
    until `over` is set; `sent` counts.
    """
    payload, attachment = os.urandom(FLOOD_BYTES), bytes(40)
    with zenoh.open(zenoh.Config.from_file(str(client))) as session:
        publisher = session.declare_publisher(
            key, congestion_control=zenoh.CongestionControl.DROP, express=True
        )
        next_s = time.monotonic()
        while not over.is_set():
            publisher.put(payload, attachment=attachment)
            sent.value += 1
            next_s = max(next_s + 1.0 / FLOOD_HZ, time.monotonic() - 0.01)
            time.sleep(max(0.0, next_s - time.monotonic()))


def stay(address: Address, over: Any, sent: "Synchronized[int]") -> None:
    """Connects, up to `CONNECTIONS` times, says nothing,
    and stays until `over` is set; `sent` counts.
    """
    limit_files(2 * CONNECTIONS)
    with contextlib.ExitStack() as connections:
        while not over.wait(0.0 if sent.value < CONNECTIONS else 0.01):
            if sent.value < CONNECTIONS:
                with contextlib.suppress(OSError):
                    connections.enter_context(socket.create_connection(address, timeout=0.2))
                    sent.value += 1


def begin_tls(address: Address, over: Any, sent: "Synchronized[int]") -> None:
    """Connects with TLS as who has no certificate, from several threads,
    until `over` is set; `sent` counts.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE

    def begin() -> None:
        while not over.is_set():
            with (
                contextlib.suppress(OSError),
                socket.create_connection(address, timeout=0.2) as plain,
            ):
                with sent.get_lock():
                    sent.value += 1
                with context.wrap_socket(plain) as refused:
                    refused.recv(1)

    threads = [threading.Thread(target=begin) for _ in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


STRANGERS = {"strangers who stay": stay, "strangers refused": begin_tls}


def free_address() -> Address:
    """A port of this computer where nobody listens."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        host, port = server.getsockname()
        return host, port


def limit_files(number: int) -> None:
    """Lets this process, and those that it starts, have so many open files."""
    resource.setrlimit(
        resource.RLIMIT_NOFILE, (number, resource.getrlimit(resource.RLIMIT_NOFILE)[1])
    )


def judged(recording: Recording, begin_ns: int) -> dict[str, Any]:
    """How a robot that was disturbed from some moment on [run's clock] fared."""
    times_ns = np.array([state.time_ns for state in recording.of(RobotState)])
    during = times_ns[(times_ns > begin_ns) & (times_ns < begin_ns + 1e9 * DURING_S)]
    return {
        "end": end_of(recording),
        "stale": stale_uses(recording),
        "state_gap_ms_p99": float(np.percentile(1e-6 * np.diff(during), 99))
        if len(during) > 1
        else float("inf"),
    }
