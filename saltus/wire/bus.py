"""Where the processes meet: newest-value topics, with every check between the wire and the caller.

Nothing that arrives can raise. What is refused is counted in `Bus.rejected["topic/reason"]`, in
this order of checks: size, envelope, payload, capture time, order. Whether a message is fresh
enough is for its consumer to judge (`saltus.runtime.ticker.staleness_of`), since only the consumer
knows the time at which it is used.
"""

import secrets
import threading
import time
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol, TypeVar

from saltus.errors import MessageError, nearest_hint
from saltus.wire import codec
from saltus.wire.codec import Envelope
from saltus.wire.messages import Message
from saltus.wire.topics import TOPICS, Topic

Taken = TypeVar("Taken")

RETIRED_SENDERS = 16
# Samples kept between two takes, so that junk beside a good message is counted and does not hide it
RING = 8
STREAM_CAPACITY = 20_000  # samples; 20 s of a run


@dataclass(frozen=True, eq=False)
class Sample:
    """A message that passed every check."""

    message: Any
    """Message, of the topic's type in `saltus.wire.topics`."""
    envelope: Envelope
    arrival_ns: int
    """When it came in, taken or not, on the monotonic clock of this machine."""


@dataclass(frozen=True, eq=False)
class RawSample:
    """A sample as it arrived, unchecked."""

    key: str
    """Below the robot's prefix, e.g. "done/render"."""
    payload: bytes
    attachment: bytes
    arrival_ns: int
    """Arrival on the monotonic clock of this machine."""


class Publisher(Protocol):
    """One key of this process."""

    def put(self, message: Message) -> None:
        """Sends; never waits for a receiver."""

    def heard(self) -> bool:
        """True where what is put reaches anybody."""


class Bell:
    """Wakes whoever waits for messages. Thread-safe.

    Who waits notes `rings`, looks whether something has come, and if not calls `wait` with what was
    noted: it returns at once where something has come in between.
    """

    def __init__(self) -> None:
        self.rings = 0
        """How often it has rung."""
        self._condition = threading.Condition(threading.Lock())

    def ring(self) -> None:
        """Wakes everybody."""
        with self._condition:
            self.rings += 1
            self._condition.notify_all()

    def wait(self, heard: int, timeout_s: float) -> None:
        """Waits until it has rung more often than `heard`, at most `timeout_s`."""
        with self._condition:
            self._condition.wait_for(lambda: self.rings != heard, timeout_s)

    def wait_for(self, take: Callable[[], Taken], timeout_s: float) -> Taken:
        """Calls `take` at each ring, for at most `timeout_s`, until it returns other than None.

        Returns what it returned last.
        """
        deadline_s, heard = time.monotonic() + timeout_s, self.rings
        while (taken := take()) is None and (left_s := deadline_s - time.monotonic()) > 0.0:
            self.wait(heard, left_s)
            heard = self.rings
        return taken


class Slot:
    """The last samples of one key; older ones than `RING` are gone.

    One thread fills it, one empties it.
    """

    def __init__(self, bell: Bell) -> None:
        self.bell = bell
        self._samples: deque[RawSample] = deque(maxlen=RING)

    def push(self, sample: RawSample) -> None:
        """Adds the newest."""
        self._samples.append(sample)
        self.bell.ring()

    def pop(self) -> RawSample | None:
        """Takes the oldest out."""
        return self._samples.popleft() if self._samples else None


class MessageStream:
    """Counted FIFO of everything on the bus, for the recorder. Thread-safe."""

    def __init__(self, capacity: int = STREAM_CAPACITY) -> None:
        self._samples: deque[RawSample] = deque()
        self._capacity = capacity
        self._lock = threading.Lock()
        self.overflowed = 0
        """Samples dropped because nobody took them in time."""
        self.end: Callable[[], object] = lambda: None
        """After it nothing comes any more; what has come can still be taken."""

    def push(self, sample: RawSample) -> None:
        """Adds a sample, or counts it as dropped."""
        with self._lock:
            if len(self._samples) < self._capacity:
                self._samples.append(sample)
            else:
                self.overflowed += 1

    def drain(self) -> list[RawSample]:
        """Returns what has arrived since the last call, in order of arrival."""
        with self._lock:
            samples, self._samples = list(self._samples), deque()
        return samples


@dataclass(frozen=True)
class ArrivalCounts:
    """Counts of what came on a key over a while."""

    topic: Topic
    received: int
    """Messages that were accepted."""
    silence_ns: int
    """The longest time without one, by the clock of this machine."""


class Latest:
    """The newest message of one key, checked."""

    def __init__(self, topic: Topic, slot: Slot, rejected: Counter[str]) -> None:
        self.topic = topic
        self.last_arrival_ns: int | None = None
        """Monotonic time of the last message that was accepted; loss is timed from it."""
        self._slot = slot
        self._rejected = rejected
        self._received = 0
        self._silence_ns = 0
        self._counted_from_ns = time.monotonic_ns()
        self._sender: Envelope | None = None
        self._retired: deque[bytes] = deque(maxlen=RETIRED_SENDERS)

    def take(self) -> Sample | None:
        """Returns the newest message that was not yet taken. Never waits, never raises."""
        newest: Sample | None = None
        while (raw := self._slot.pop()) is not None:
            newest = self._check(raw) or newest
        return newest

    def wait(self, timeout_s: float) -> Sample | None:
        """Waits for the next message, at most `timeout_s`."""
        return self._slot.bell.wait_for(self.take, timeout_s)

    def silent_s(self) -> float:
        """Seconds since the last accepted message; infinite before the first."""
        if self.last_arrival_ns is None:
            return float("inf")
        return 1e-9 * (time.monotonic_ns() - self.last_arrival_ns)

    def take_intake(self) -> ArrivalCounts:
        """Intake since the last call."""
        now_ns = time.monotonic_ns()
        last_ns = max(self._counted_from_ns, self.last_arrival_ns or 0)
        intake = ArrivalCounts(self.topic, self._received, max(self._silence_ns, now_ns - last_ns))
        self._received, self._silence_ns, self._counted_from_ns = 0, 0, now_ns
        return intake

    def _check(self, raw: RawSample) -> Sample | None:
        try:
            envelope, message = unpack_sample(self.topic, raw)
            self._check_order(envelope)
        except MessageError as error:
            self._rejected[f"{self.topic.name}/{error.reason}"] += 1
            return None
        self._sender = envelope
        self._received += 1
        self._silence_ns = max(
            self._silence_ns, raw.arrival_ns - (self.last_arrival_ns or self._counted_from_ns)
        )
        self.last_arrival_ns = raw.arrival_ns
        return Sample(message, envelope, raw.arrival_ns)

    def _check_order(self, envelope: Envelope) -> None:
        last = self._sender
        if envelope.boot_id in self._retired:
            raise MessageError("old_sender", "a newer process has taken over")
        if last is None:
            return
        if envelope.boot_id != last.boot_id:
            self._retired.append(last.boot_id)
        elif envelope.sequence == last.sequence:
            raise MessageError("duplicate", f"sequence {envelope.sequence}")
        elif envelope.sequence < last.sequence:
            raise MessageError(
                "out_of_order", f"sequence {envelope.sequence} after {last.sequence}"
            )


def unpack_sample(topic: Topic, raw: RawSample) -> tuple[Envelope, Message]:
    """Checks a sample by itself; `MessageError` as in the module's docstring."""
    if len(raw.payload) > codec.PAYLOAD_MAX:
        raise MessageError("size", f"{len(raw.payload)} bytes")
    envelope = Envelope.from_bytes(raw.attachment)
    message: Message = codec.decode_message(topic.message, raw.payload)
    if message.time_ns != envelope.capture_ns:
        raise MessageError(
            "capture_time",
            f"{message.time_ns} ns in the message, {envelope.capture_ns} ns beside it",
        )
    return envelope, message


class Bus(ABC):
    """The other processes as one sees them, below the prefix of the robot's keys.

    The bell is rung whenever a message comes in that somebody waits for. Buses may share one, for a
    process that waits for any of several robots.
    """

    def __init__(self, prefix: str, bell: Bell) -> None:
        self.prefix = prefix
        self.bell = bell
        self.boot_id = secrets.token_bytes(16)
        self.muted = False
        """True where what is put is dropped: of a process that works along beside the one that is
        heard."""
        self.rejected: Counter[str] = Counter()
        """Messages refused so far by "topic/reason"."""
        self.latests: list[Latest] = []
        """Newest messages of the keys that were asked for."""

    @abstractmethod
    def publisher(self, topic: str, suffix: str = "") -> Publisher:
        """A publisher of `topic`, or of `topic/suffix` where every process has a key of its own."""

    @abstractmethod
    def latest(self, topic: str, suffix: str = "", *, rings: bool = True) -> Latest:
        """The newest message of one concrete key.

        Without `rings` nobody is woken by it, and it costs half as much: for those who look when
        they need it.
        """

    @abstractmethod
    def stream(self, capacity: int = STREAM_CAPACITY) -> MessageStream:
        """Everything below the prefix."""

    @abstractmethod
    def connected(self) -> bool:
        """True where messages can travel now."""

    @abstractmethod
    def close(self) -> None:
        """Leaves the bus; may be called twice."""

    def __enter__(self) -> "Bus":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _latest(self, topic: str, slot: Slot) -> Latest:
        codec.prepare(TOPICS[topic].message)
        self.latests.append(Latest(TOPICS[topic], slot, self.rejected))
        return self.latests[-1]

    def _key(self, topic: str, suffix: str) -> str:
        if topic not in TOPICS:
            raise MessageError("topic", f"no topic '{topic}': {nearest_hint(topic, TOPICS)}")
        return "/".join(part for part in (self.prefix, topic, suffix) if part)


@lru_cache(maxsize=256)
def topic_of(key: str) -> Topic | None:
    """The topic of a key below the prefix: "done" of "done/render"; None where there is none."""
    return TOPICS.get(key) or TOPICS.get(key.rpartition("/")[0])


def sender_of(key: str) -> str:
    """The process that publishes under a key below the prefix: "render" of "done/render"; ""
    where there is none.
    """
    topic = topic_of(key)
    if topic is None:
        return ""
    return key.rpartition("/")[2] if topic.publisher == "*" else topic.publisher
