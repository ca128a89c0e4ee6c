"""Messages that a process says again beside those that a recording has of it."""

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from saltus.recordings.recording import RecordedMessage, Recording
from saltus.wire import codec
from saltus.wire.bus import sender_of, topic_of
from saltus.wire.messages import Message


@dataclass(frozen=True, kw_only=True)
class MessageDifference:
    """A field of a message that is not as it was, or a message that one side alone has."""

    topic: str
    time_ns: int
    field: str
    """With the place in an array, e.g. "height[3]"; empty for a whole message."""
    recorded: object
    """None where the recording has no such message."""
    replayed: object
    """None where it was not said again."""

    def __str__(self) -> str:
        where = f"{self.topic} at {1e-9 * self.time_ns:.3f} s"
        if not self.field:
            return f"{where}: {'not recorded' if self.recorded is None else 'not said again'}"
        return f"{where}: {self.field} was {self.recorded}, is {self.replayed}"


@dataclass(kw_only=True)
class TopicCounts:
    """How the messages of a topic compare."""

    equal: int = 0
    differ: int = 0
    missing: int = 0
    """Recorded, and not said again."""
    more: int = 0
    """Said now, and not recorded."""


@dataclass(kw_only=True)
class FieldDifference:
    """How a field differs, in those messages in which it does."""

    messages: int = 0
    largest: float = 0.0
    """Largest absolute difference of two numbers; 0 where they are no numbers."""


class AnswerComparison:
    """Takes in what a process says again, message by message, and compares it byte by byte.

    Messages of a topic belong together by their capture time. One that is said twice counts once,
    as in a recording. Proofs of life, which have the time of the machine, do not count, nor do
    events of a real-time run, whose details have it.
    """

    def __init__(self, recording: Recording, sender: str) -> None:
        keys = [key for key in recording.senders if sender_of(key) == sender]
        lockstep = recording.known_config.pace == "lockstep"
        self._ignored = {"status"} if lockstep else {"status", "event"}
        if f"done/{sender}" not in keys:  # of a real-time run, or not recorded, as once
            self._ignored.add("done")
        self._recorded = {
            key: _Recorded(recording.arrivals_of([key])) for key in keys if self._counts(key)
        }
        self.topics = {key: TopicCounts() for key in self._recorded}
        """By topic."""
        self.fields: dict[str, FieldDifference] = {}
        """By topic and field, e.g. "policy/plan.velocity_x"."""
        self.first: MessageDifference | None = None
        """The first difference, in the order in which messages were said; None where all is
        equal."""
        self._said: dict[str, bytes] = {}

    @property
    def compared(self) -> int:
        """Messages that both sides have."""
        return sum(counts.equal + counts.differ for counts in self.topics.values())

    def take(self, topic: str, message: Message, payload: bytes) -> None:
        """Compares a message with the recorded one of its time."""
        if not self._counts(topic) or self._said.get(topic) == payload:
            return
        self._said[topic] = payload
        recorded = self._recorded.setdefault(topic, _Recorded(iter(())))
        counts = self.topics.setdefault(topic, TopicCounts())
        self._pass_over(topic, message.time_ns)
        if recorded.next_ns != message.time_ns:
            counts.more += 1
            self._note(topic, message.time_ns, "", None, message)
            return
        before = recorded.take()
        if before == payload:
            counts.equal += 1
            return
        counts.differ += 1
        old = codec.decode_message(type(message), before)
        for name in (f.name for f in fields(message)):
            place, was, now, apart = _changed(name, getattr(old, name), getattr(message, name))
            if place:
                row = self.fields.setdefault(f"{topic}.{name}", FieldDifference())
                row.messages += 1
                row.largest = max(row.largest, apart)
                self._note(topic, message.time_ns, place, was, now)

    def finish(self) -> None:
        """Counts what is recorded and was not said again."""
        for topic in self._recorded:
            self._pass_over(topic, None)

    def _counts(self, topic: str) -> bool:
        row = topic_of(topic)
        return row is not None and row.name not in self._ignored

    def _pass_over(self, topic: str, until_ns: int | None) -> None:
        recorded = self._recorded[topic]
        while (time_ns := recorded.next_ns) is not None and (
            until_ns is None or time_ns < until_ns
        ):
            self.topics[topic].missing += 1
            self._note(topic, time_ns, "", recorded.take(), None)

    def _note(
        self, topic: str, time_ns: int, place: str, recorded: object, replayed: object
    ) -> None:
        self.first = self.first or MessageDifference(
            topic=topic, time_ns=time_ns, field=place, recorded=recorded, replayed=replayed
        )


class _Recorded:
    """Recorded messages of one topic, one after the other."""

    def __init__(self, arrivals: Iterator[RecordedMessage]) -> None:
        self._arrivals = arrivals
        self._next = next(arrivals, None)

    @property
    def next_ns(self) -> int | None:
        """Capture time of the next one; None after the last."""
        return None if self._next is None else self._next.envelope.capture_ns

    def take(self) -> bytes:
        """The payload of the next one."""
        assert self._next is not None  # noqa: S101 - it has a time
        payload, self._next = self._next.payload, next(self._arrivals, None)
        return payload


def _changed(name: str, was: object, now: object) -> tuple[str, object, object, float]:
    """Place of the first entry that is not as it was, both values there,
    and by how much any entry differs at most.

    The place is empty where all is equal.
    """
    old, new = np.asarray(was), np.asarray(now)
    if old.shape != new.shape:
        return name, f"of shape {old.shape}", f"of shape {new.shape}", 0.0
    if old.dtype.kind not in "biuf":
        return ("" if was == now else name), was, now, 0.0
    differs = (old != new) & ~((old != old) & (new != new))
    if not differs.any():
        return "", was, now, 0.0
    index = tuple(int(i) for i in np.argwhere(differs)[0])
    place = f"{name}[{', '.join(map(str, index))}]" if index else name
    apart = np.abs(new.astype(np.float64) - old.astype(np.float64))[differs]
    return place, old[index].item(), new[index].item(), float(np.max(apart))
