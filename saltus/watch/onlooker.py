"""Everything on the bus of a robot, for who looks on."""

import time

from saltus.wire.bus import RawSample, Stream
from saltus.wire.sharing import PERIOD_S, unpacked
from saltus.wire.zenoh_bus import ZenohBus

UNSHARED_NS = 1_000_000_000
"""Silence after which a reader listens for itself. A supervisor hands on each `PERIOD_S`, be it
nothing."""
WAITED_NS = round(2e9 * PERIOD_S)
"""A batch that is later than this is missed."""


class Onlooker:
    """All messages, as the supervisor of the robot hands them on; while there is none, it listens for itself.

    A supervisor that loads its processes hands on nothing for a second and more.

    Args:
        bus: Of the robot.
        capacity: Samples that may wait to be taken; what comes beyond is dropped.
    """

    def __init__(self, bus: ZenohBus, capacity: int) -> None:
        self._bus, self._capacity = bus, capacity
        self._shared = Stream(capacity)
        self._own: Stream | None = None
        self._heard_itself: dict[tuple[str, bytes], int] = {}
        """When it heard what it may be handed on as well [ns]."""
        self._heard_ns = time.monotonic_ns()
        bus.look_on(self._receive)

    def drain(self) -> list[RawSample]:
        """Messages since the last call, in order of arrival."""
        shared = self._shared.drain()
        if self._own is None:
            if time.monotonic_ns() - self._heard_ns > UNSHARED_NS:
                self._own = self._bus.stream(self._capacity)
            return self._unheard(shared)
        own = self._own.drain()
        if shared:
            self._own.end()
            own += self._own.drain()
            self._own = None
        since_ns = time.monotonic_ns() - UNSHARED_NS
        self._heard_itself = {heard: at_ns for heard, at_ns in self._heard_itself.items() if at_ns > since_ns}
        self._heard_itself |= {(raw.key, raw.attachment): raw.arrival_ns for raw in own}
        return own + self._unheard(shared)

    def heard_until_ns(self) -> int:
        """The time by this machine's monotonic clock until which it knows what was said: that of the newest batch.

        While no batches come, time goes on all the same, and what was said last grows old.
        """
        now_ns = time.monotonic_ns()
        return now_ns if self._own is not None else max(self._heard_ns, now_ns - WAITED_NS)

    def _unheard(self, shared: list[RawSample]) -> list[RawSample]:
        """Samples handed on that it has not heard itself; an attachment counts the messages of its sender."""
        if self._heard_itself and shared and shared[0].arrival_ns > max(self._heard_itself.values()) + WAITED_NS:
            self._heard_itself = {}
        return [raw for raw in shared if (raw.key, raw.attachment) not in self._heard_itself]

    def _receive(self, batch: bytes) -> None:
        self._heard_ns = time.monotonic_ns()
        for sample in unpacked(batch):
            self._shared.push(sample)
