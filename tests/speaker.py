"""A run whose robot says the same thing every 10 ms, without physics or networks."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from recorded import MS, run_messages
from samples import put_run

from saltus.clock import RunClock
from saltus.config import RunConfig, to_toml
from saltus.runtime.run_folder import CLIENT_FILE, RUN_FILE
from saltus.wire.joining import write_client
from saltus.wire.messages import Event, Message
from saltus.wire.router import open_router
from saltus.wire.zenoh_bus import ZenohBus

PERIOD_S = 0.01
EVENT = Event(time_ns=5 * MS, process="heightmap", code="depth_lost")
SAID: list[tuple[str, Message]] = [*run_messages(0), ("event/heightmap", EVENT)]


@contextmanager
def speaking(
    folder: Path, prefix: str = RunConfig(robot="go1", grid="line").prefix
) -> Iterator[threading.Event]:
    """Makes a folder that of such a run, with its router; its keys have a prefix.

    Setting the event ends it.
    """
    config = RunConfig(
        robot="go1", grid="line", pace="realtime", epoch_ns=time.monotonic_ns() - 10**9
    )
    (put_run(folder, config) / RUN_FILE).write_text(to_toml(config))
    endpoint, router = open_router()
    write_client(folder / CLIENT_FILE, endpoint)
    ended, clock = threading.Event(), RunClock.of(config)

    def say() -> None:
        with ZenohBus(endpoint, prefix) as bus:
            split = {
                key: key.split("/") if key.startswith(("status", "event")) else (key,)
                for key, _ in SAID
            }
            publishers = {key: bus.publisher(*split[key]) for key, _ in SAID}
            while not ended.wait(PERIOD_S):
                now_ns = clock.now_ns()
                for key, message in SAID:
                    publishers[key].put(replace(message, time_ns=now_ns))
        router.close()

    speaker = threading.Thread(target=say)
    speaker.start()
    try:
        yield ended
    finally:
        ended.set()
        speaker.join()
