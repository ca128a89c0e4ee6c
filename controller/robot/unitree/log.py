"""Records what a robot says and is told, at full rate, as rosbag2 would name it."""

import math
import time
from collections import deque
from pathlib import Path
from queue import Empty, SimpleQueue

from saltus.controller.robot.unitree.link import COMMANDS, STATES, TYPES, ArrivedMessage
from saltus.controller.robot.unitree.states import StateWatch
from saltus.interrupts import WHOLE
from saltus.recordings.cdr_log import CdrLog

TOPICS = {COMMANDS: "/lowcmd", STATES: "/lowstate"}
"""ROS 2's names of the topics: without the `rt` that it puts before all."""
WAIT_S = 0.1
TURN_S = 0.5
"""Beside six busy programs a thread waits a tenth of that for its turn."""
SEEN_NS, BEGINS_NS = 5 * 10**9, 10**9
"""How far back the way of a message is compared: two clocks of quartz (20 ppm) drift apart by 0.1
ms meanwhile. And the time in which even a computer that is busy takes some message at once."""


def new_log(path: Path) -> CdrLog:
    """An empty recording of a robot; the errors of `CdrLog`."""
    return CdrLog(path, {topic: TYPES[name] for name, topic in TOPICS.items()})


class ArrivalEstimator:
    """Tells when the messages of one sender came, however late they were taken.

    A program that records takes them some ms late when its computer is busy, and then a command may
    seem to have come after the state that answers it. What passes between a message's two times
    (when it was sent, by its sender's clock, and when it was taken, by ours) is the difference of
    the clocks, the way, and that lateness: the least of the last seconds has none. At the beginning
    there are none, so the first messages wait for those of a second.
    """

    def __init__(self) -> None:
        self._least: deque[tuple[int, int]] = deque()
        """When messages were taken, and what had passed [ns]: both rise."""
        self._held: deque[ArrivedMessage] = deque()
        self._held_until_ns = self._sent_ns = self._arrival_ns = 0

    def take(self, arrived: ArrivedMessage) -> list[tuple[int, ArrivedMessage]]:
        """Takes the next message; returns what need not wait any longer, as `rest` does."""
        told, taken_ns = [], arrived.arrival_ns
        passed_ns = taken_ns - arrived.sent_ns
        if arrived.sent_ns <= self._sent_ns:  # its clock was set back
            told = self.rest()
            self._least.clear()
        if not self._least:
            self._held_until_ns = taken_ns + BEGINS_NS
        self._sent_ns = arrived.sent_ns
        while self._least and self._least[-1][1] >= passed_ns:
            self._least.pop()
        self._least.append((taken_ns, passed_ns))
        while self._least[0][0] < taken_ns - SEEN_NS:
            self._least.popleft()
        self._held.append(arrived)
        return told + self.rest() if taken_ns >= self._held_until_ns else told

    def rest(self) -> list[tuple[int, ArrivedMessage]]:
        """The messages that wait, in their order, and when they came [ns, as their `arrival_ns`].

        None comes before an earlier one. One came when it was taken if its sender tells no time.
        """
        return [self._tell() for _ in range(len(self._held))]

    def _tell(self) -> tuple[int, ArrivedMessage]:
        arrived = self._held.popleft()
        self._arrival_ns = max(self._arrival_ns, arrived.sent_ns + self._least[0][1])
        return self._arrival_ns, arrived


def record_link(
    arrivals: "SimpleQueue[tuple[str, ArrivedMessage]]",
    log: CdrLog,
    watch: StateWatch,
    seconds: float,
) -> None:
    """Records what a link hears, for some seconds; `watch` counts the states.

    After the end, and after Ctrl-C, it listens for half a second more: what came before may not
    have been taken yet.

    Raises:
        RecordingError: the file cannot be written.
    """
    since_1970_ns = time.time_ns() - time.monotonic_ns()
    senders = {name: ArrivalEstimator() for name in TOPICS}

    def write(name: str, told: list[tuple[int, ArrivedMessage]], end_ns: float) -> None:
        for arrival_ns, arrived in told:
            if arrival_ns > end_ns:
                return
            log.write(TOPICS[name], arrived.payload, since_1970_ns + arrival_ns, arrived.sent_ns)
            if name == STATES:
                watch.take([arrived.payload], 1e-9 * arrived.arrival_ns)

    def listen(until_s: float, end_ns: float = math.inf) -> None:
        while time.monotonic() < until_s:
            log.flush()
            with WHOLE:  # Ctrl-C does not lose the one in hand
                try:
                    name, arrived = arrivals.get(timeout=WAIT_S)
                except Empty:
                    write_rest(end_ns)
                else:
                    write(name, senders[name].take(arrived), end_ns)

    def write_rest(end_ns: float) -> None:
        for name, sender in senders.items():
            write(name, sender.rest(), end_ns)

    def end() -> None:
        end_ns = time.monotonic_ns()
        try:
            listen(time.monotonic() + TURN_S, end_ns)
        finally:
            write_rest(end_ns)

    try:
        listen(time.monotonic() + seconds)
    except KeyboardInterrupt:
        end()
        raise
    end()
