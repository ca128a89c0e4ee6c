"""Records what a robot says and is told, at full rate, as rosbag2 would name it."""

import contextlib
import time
from collections import deque
from pathlib import Path
from queue import Empty, SimpleQueue

from saltus.controller.robot.unitree.link import COMMANDS, STATES, TYPES, ArrivedMessage
from saltus.controller.robot.unitree.states import StateWatch
from saltus.recordings.cdr_log import CdrLog

TOPICS = {COMMANDS: "/lowcmd", STATES: "/lowstate"}
"""ROS 2's names of the topics: without the `rt` that it puts before all."""
WAIT_S = 0.1
SEEN_NS = 5 * 10**9
"""How far back the way of a message is compared: two clocks of quartz (20 ppm) drift apart by 0.1
ms meanwhile."""


def new_log(path: Path) -> CdrLog:
    """An empty recording of a robot; the errors of `CdrLog`."""
    return CdrLog(path, {topic: TYPES[name] for name, topic in TOPICS.items()})


class ArrivalEstimator:
    """Tells when the messages of one sender came, however late they were taken.

    A program that records takes them some ms late when its computer is busy, and then a command may
    seem to have come after the state that answers it. What passes between a message's two times
    (when it was sent, by its sender's clock, and when it was taken, by ours) is the difference of
    the clocks, the way, and that lateness: the least of the last seconds has none.
    """

    def __init__(self) -> None:
        self._least: deque[tuple[int, int]] = deque()
        """When messages were taken, and what had passed [ns]: both rise."""
        self._sent_ns = self._arrival_ns = 0

    def arrival_ns(self, arrived: ArrivedMessage) -> int:
        """When the next message came [ns, as its `arrival_ns`]; never before an earlier one.

        It is that at which it was taken where its sender tells no time.
        """
        taken_ns, passed_ns = arrived.arrival_ns, arrived.arrival_ns - arrived.sent_ns
        if arrived.sent_ns <= self._sent_ns:
            self._least.clear()  # its clock was set back
        self._sent_ns = arrived.sent_ns
        while self._least and self._least[-1][1] >= passed_ns:
            self._least.pop()
        self._least.append((taken_ns, passed_ns))
        while self._least[0][0] < taken_ns - SEEN_NS:
            self._least.popleft()
        self._arrival_ns = max(self._arrival_ns, arrived.sent_ns + self._least[0][1])
        return self._arrival_ns


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
    senders = {name: ArrivalEstimator() for name in TOPICS}

    def write(name: str, arrived: ArrivedMessage) -> None:
        arrival_ns = since_1970_ns + senders[name].arrival_ns(arrived)
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
