"""Records what a robot says and is told, at full rate, as rosbag2 would name it."""

import contextlib
import time
from pathlib import Path
from queue import Empty, SimpleQueue

from saltus.controller.robot.unitree.link import COMMANDS, STATES, TYPES, ArrivedMessage
from saltus.controller.robot.unitree.states import StateWatch
from saltus.recordings.cdr_log import CdrLog

TOPICS = {COMMANDS: "/lowcmd", STATES: "/lowstate"}
"""ROS 2's names of the topics: without the `rt` that it puts before all."""
WAIT_S = 0.1


def new_log(path: Path) -> CdrLog:
    """An empty recording of a robot; the errors of `CdrLog`."""
    return CdrLog(path, {topic: TYPES[name] for name, topic in TOPICS.items()})


def record_link(
    arrivals: "SimpleQueue[tuple[str, ArrivedMessage]]",
    log: CdrLog,
    watch: StateWatch,
    seconds: float,
) -> None:
    """Records what a link hears, for some seconds; `watch` counts the states.

    Raises:
        RecordingError: the file cannot be written.
    """
    since_1970_ns = time.time_ns() - time.monotonic_ns()
    until_s = time.monotonic() + seconds

    def write(name: str, arrived: ArrivedMessage) -> None:
        arrival_ns = since_1970_ns + arrived.arrival_ns
        log.write(TOPICS[name], arrived.payload, arrival_ns, arrived.sent_ns)
        if name == STATES:
            watch.take([arrived.payload], 1e-9 * arrived.arrival_ns)

    try:
        while time.monotonic() < until_s:
            log.flush()
            with contextlib.suppress(Empty):
                write(*arrivals.get(timeout=WAIT_S))
    finally:  # after Ctrl-C, too: what has come already
        for _ in range(arrivals.qsize()):
            write(*arrivals.get())
