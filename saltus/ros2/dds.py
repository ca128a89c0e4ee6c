"""A ROS 2 graph over plain DDS, for robots whose middleware is Cyclone DDS or Fast DDS.

Payloads are those that travel over Zenoh: CDR, made and read by the same lines.
"""

import contextlib
import time
from typing import Any

from cyclonedds.core import DDSException, Listener, Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from saltus.dds_types import raw_type_of
from saltus.errors import StackError
from saltus.wire.bus import RawSample, Slot
from saltus.wire.codec import PAYLOAD_MAX

BLOCKED_MS = 10  # a reliable writer waits so long for a reader that is behind, then drops
DEPTH = 10  # the default of ROS


class DdsNode:
    """A ROS 2 node on DDS, with the methods of `Ros2Node`; it needs no router.

    Raises:
        StackError: no network interface can be used.
    """

    def __init__(self, domain: int) -> None:
        try:
            self._participant = DomainParticipant(domain)
        except DDSException as error:
            raise StackError(f"DDS cannot be joined in domain {domain}: {error}") from error
        self._publisher, self._subscriber = (
            Publisher(self._participant),
            Subscriber(self._participant),
        )
        self._kept: list[Any] = []

    def __enter__(self) -> "DdsNode":
        return self

    def __exit__(self, *_: object) -> None:
        for reader in self._kept:
            reader.set_listener(None)

    def connected(self) -> bool:
        """True: there is no router between this node and others that might be missing."""
        return True

    def publisher(self, topic: str, type_name: str, type_hash: str) -> "DdsPublisher":
        """See `Ros2Node.publisher`."""
        kind = raw_type_of(type_name)
        writer = DataWriter(
            self._publisher, Topic(self._participant, _rt(topic), kind),
            qos=_quality(Policy.Reliability.Reliable(duration(milliseconds=BLOCKED_MS)), type_hash),
        )  # fmt: skip
        return DdsPublisher(writer, kind)

    def subscribe(self, topic: str, type_name: str, type_hash: str, slot: Slot) -> None:
        """See `Ros2Node.subscribe`; of reliable writers as of those of best effort."""
        kind = raw_type_of(type_name)
        reader = DataReader(
            self._subscriber, Topic(self._participant, _rt(topic), kind),
            qos=_quality(Policy.Reliability.BestEffort, type_hash), listener=_Intake(topic, slot),
        )  # fmt: skip
        self._kept.append(reader)


class DdsPublisher:
    """Sends the messages of one topic."""

    def __init__(self, writer: Any, kind: Any) -> None:
        self._writer = writer
        self._kind = kind

    def put(self, payload: bytes, wall_ns: int) -> None:
        """Sends CDR, as of a time since 1970 [ns].

        What readers that are behind do not take is dropped.
        """
        sample = object.__new__(self._kind)
        sample.payload = payload
        with contextlib.suppress(DDSException):
            self._writer.write(sample, timestamp=wall_ns)


class _Intake(Listener):
    """Puts what comes into a slot, by Cyclone's threads."""

    def __init__(self, topic: str, slot: Slot) -> None:
        super().__init__()
        self._topic, self._slot = topic, slot

    def on_data_available(self, reader: Any) -> None:
        for sample in reader.take(N=DEPTH):
            payload = getattr(sample, "payload", b"")
            if 0 < len(payload) <= PAYLOAD_MAX:
                self._slot.push(RawSample(self._topic, payload, b"", time.monotonic_ns()))


def _rt(topic: str) -> str:
    """As ROS names its topics in DDS."""
    return f"rt/{topic.strip('/')}"


def _quality(reliability: Any, type_hash: str) -> Any:
    return Qos(
        reliability, Policy.Durability.Volatile, Policy.History.KeepLast(DEPTH),
        Policy.Userdata(f"typehash={type_hash};".encode()),
    )  # fmt: skip
