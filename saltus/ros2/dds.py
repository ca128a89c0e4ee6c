"""A ROS 2 graph over plain DDS, for robots whose middleware is Cyclone DDS or Fast DDS.

Payloads are those that travel over Zenoh: CDR, made and read by the same lines. Cyclone is told the
types only so that others can compare them: with octets for every uint8, as a type of Cyclone 11's
own that 0.10 does not know makes a peer of 0.10 end with a segmentation fault as soon as it hears
of it.
"""

import contextlib
import time
from functools import cache
from typing import Any

from cyclonedds.core import DDSException, Listener, Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.idl.annotations import final
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from saltus.errors import StackError
from saltus.recordings import ros_messages as ros
from saltus.wire.bus import RawSample, Slot
from saltus.wire.codec import PAYLOAD_MAX
from saltus.wire.ros2_node import dds_name

BLOCKED_MS = 10  # a reliable writer waits so long for a reader that is behind, then drops
DEPTH = 10  # the default of ROS
BASE = {
    "bool": bool, "byte": types.byte, "char": types.char, "string": str, "uint8": types.byte,
    "int8": types.int8,
    "int16": types.int16, "uint16": types.uint16, "int32": types.int32, "uint32": types.uint32,
    "int64": types.int64,
    "uint64": types.uint64, "float32": types.float32, "float64": types.float64,
}  # fmt: skip


@cache
def type_of(type_name: str) -> Any:
    """The type as Cyclone knows it."""
    fields = {name: _field(kind) for name, kind in ros.fields_of(type_name)}
    return final(make_idl_struct(type_name.rpartition("/")[2] + "_", dds_name(type_name), fields))


@cache
def raw_type_of(type_name: str) -> Any:
    """The same, of samples that are bytes: what is sent is not made, and what comes not read, field by field."""
    kind = type_of(type_name)

    def deserialize(data: bytes, **_: Any) -> Any:
        sample = object.__new__(kind)
        sample.payload = bytes(data)
        return sample

    kind.deserialize = staticmethod(deserialize)
    kind.serialize = lambda self, **_: self.payload
    return kind


def _field(kind: tuple[str, Any]) -> Any:
    form, what = kind
    if form == "base":
        return BASE[what]
    if form == "type":
        return type_of(what)
    inner, count = what
    array: Any = types.array
    sequence: Any = types.sequence
    return array[_field(inner), count] if form == "array" else sequence[_field(inner)]


class DdsNode:
    """The same as `Ros2Node`, without a router.

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
        """There is nothing between others and this."""
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
