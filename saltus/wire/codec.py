"""Messages as CDR bytes of ROS 2 types, and back, with every check that a stranger's bytes need.

`decode_message` returns a message that is whole, finite and plausible, or raises `MessageError`:
nothing else, whatever the bytes. The envelope is the attachment of rmw_zenoh: sequence, capture
time and the identity of the sender.

Kinds that come many times a second are read and written by templates
(`saltus.wire.message_templates`); the codecs here are their reference.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar, cast

import numpy as np

from saltus.arrays import Indices
from saltus.errors import MessageError
from saltus.wire import ros_types, schemas
from saltus.wire.cdr import (
    FORMER,
    STORE,
    TIME_MAX_NS,
    TIME_MIN_NS,
    check_bounded,
    checked_text,
    make_ros_header,
    make_ros_time,
    parse_ros_message,
    ros2msg_definition,
    time_of,
)
from saltus.wire.depth_codec import DEPTH_FIXED, DEPTH_HOLES, decode_depth, depth_on_the_wire
from saltus.wire.message_templates import TemplateBounds, Templates
from saltus.wire.messages import DepthFrame, Event, Message, ProcessStatus
from saltus.wire.schemas import FIELDS, TYPE_NAME
from saltus.wire.table_codec import NORM_SQUARED, TableCodec

M = TypeVar("M", bound=Message)

PAYLOAD_MAX = 4 * 2**20  # bytes; a depth image of 1280x720 has 1.8 MB
LOG_INFO = 20  # rcl_interfaces/msg/Log
_ENVELOPE = struct.Struct("<qqB16s")


@dataclass(frozen=True)
class Envelope:
    """The attachment of a payload, in the layout of rmw_zenoh."""

    sequence: int
    """Counts the messages of one publisher from 1."""
    capture_ns: int
    """`time_ns` of the message."""
    boot_id: bytes
    """16 random bytes, new at each start of a process."""

    def to_bytes(self) -> bytes:
        """The attachment, 33 bytes."""
        return _ENVELOPE.pack(self.sequence, self.capture_ns, 16, self.boot_id)

    @classmethod
    def from_bytes(cls, data: bytes) -> "Envelope":
        """Reads an attachment; `MessageError` "envelope" for a wrong length,
        or a sequence below 1.
        """
        if len(data) != _ENVELOPE.size:
            raise MessageError("envelope", f"{len(data)} bytes instead of {_ENVELOPE.size}")
        sequence, capture_ns, size, boot_id = _ENVELOPE.unpack(data)
        if size != 16 or sequence < 1:
            raise MessageError("envelope", f"identity of {size} bytes, sequence {sequence}")
        return cls(sequence, capture_ns, boot_id)


def encoding_of(kind: type[Message]) -> str:
    """The Zenoh encoding of a message: metadata for viewers."""
    return f"application/cdr;schema={TYPE_NAME[kind]}"


def prepare(kind: type[Message]) -> None:
    """Makes what the first message of a kind needs, and would else wait for: 3 to 20 ms of work."""
    STORE.get_msgdef(TYPE_NAME[kind])


def encode_message(message: Message) -> bytes:
    """Writes a message as CDR; `MessageError`
    where a field does not have the shape or type that travels.

    Values are checked by `decode_message`: what is sent is for the receiver to judge.
    """
    kind = type(message)
    try:
        templates = _TEMPLATES.get(kind)
        return reference_bytes(message) if templates is None else templates.encode(message)
    except MessageError:
        raise
    except Exception as error:
        raise MessageError("unencodable", f"{kind.__name__}: {error}") from error


def decode_message(kind: type[M], data: bytes) -> M:
    """Reads and checks a message. Arrays of the result are read-only.

    A `MessageError` has the reason "empty", "size", "malformed", "shape", "not_finite", "range",
    "enum" or "encoding".
    """
    if not data:
        raise MessageError("empty")
    if len(data) > PAYLOAD_MAX:
        raise MessageError("size", f"{len(data)} bytes, at most {PAYLOAD_MAX}")
    try:
        templates = _TEMPLATES.get(kind)
        return reference_message(kind, data) if templates is None else templates.decode(data)
    except MessageError:
        raise
    except Exception as error:  # the parser's errors on hostile bytes are of many types
        raise MessageError("malformed", f"{kind.__name__}: {error}") from error


def reference_bytes(message: Message) -> bytes:
    """The bytes of a message, written field by field."""
    kind = type(message)
    return bytes(STORE.serialize_cdr(_ENCODERS[kind](message), TYPE_NAME[kind]))


def reference_message(kind: type[M], data: bytes) -> M:
    """The message, read field by field."""
    return cast(M, _DECODERS[kind](parse_ros_message(TYPE_NAME[cast(Any, kind)], data)))


def former_definitions_of(kind: type[Message]) -> list[str]:
    """The `ros2msg` schema texts of a message in older recordings, the newest first."""
    return [ros2msg_definition(name) for name in FORMER.get(kind, ())]


def of_today(kind: type[Message], former: int, data: bytes) -> bytes:
    """The bytes of today for those of a message of an older recording,
    `former` in `former_definitions_of`.

    Raises:
        MessageError: they are none.
    """
    try:
        old, table = parse_ros_message(FORMER[kind][former], data), _TABLES[kind]
        values = [
            getattr(old, f.name) if hasattr(old, f.name) else table.lacking(f.name)
            for f in table.fields
        ]
        return bytes(STORE.serialize_cdr(table.wire_type(old.header, *values), TYPE_NAME[kind]))
    except MessageError:
        raise
    except Exception as error:  # the parser's errors on hostile bytes are of many types
        raise MessageError("malformed", f"{kind.__name__}: {error}") from error


def _encode_event(message: Event) -> ros_types.StampedRosMessage:
    text = message.detail[: schemas.TEXT_MAX]
    wire_type: Callable[..., ros_types.StampedRosMessage] = STORE.types[schemas.EVENT_TYPE]
    return wire_type(
        make_ros_time(message.time_ns), LOG_INFO, message.process, text, "", message.code, 0
    )


def _decode_event(wire: Any) -> Event:
    process, code, detail = (
        checked_text("name", wire.name),
        checked_text("function", wire.function),
        checked_text("msg", wire.msg),
    )
    return Event(time_ns=time_of(wire.stamp), process=process, code=code, detail=detail)


def _encode_status(message: ProcessStatus) -> ros_types.StampedRosMessage:
    names, topics = list(message.rejected), list(message.received)
    wire_type: Callable[..., ros_types.StampedRosMessage] = STORE.types[schemas.STATUS_TYPE]
    return wire_type(
        make_ros_header(message.time_ns, schemas.FRAME[ProcessStatus]),
        message.process,
        bool(message.ready),
        int(message.ticks),
        int(message.overruns),
        names,
        np.array([message.rejected[name] for name in names], dtype=np.int64),
        topics,
        np.array([message.received[name] for name in topics], dtype=np.int64),
        np.array([message.silence_us[name] for name in topics], dtype=np.int64),
    )


def _decode_status(wire: Any) -> ProcessStatus:
    for name, value in (("ticks", wire.ticks), ("overruns", wire.overruns)):
        check_bounded(name, value, 0, schemas.INDEX_MAX)
    return ProcessStatus(
        time_ns=time_of(wire.header.stamp),
        process=checked_text("process", wire.process),
        ready=wire.ready,
        ticks=wire.ticks,
        overruns=wire.overruns,
        rejected=_counts("rejected", wire.rejected, wire.rejected_count),
        received=_counts("received", wire.received, wire.received_count),
        silence_us=_counts("silence_us", wire.received, wire.silence_us),
    )


def _counts(name: str, keys: Sequence[str], counts: Indices) -> dict[str, int]:
    if len(keys) != counts.size:
        raise MessageError("shape", f"{name}: {len(keys)} names with {counts.size} counts")
    return {checked_text(name, key): int(count) for key, count in zip(keys, counts, strict=True)}


_TABLES = {kind: TableCodec(kind) for kind in FIELDS}
_ENCODERS: dict[type[Message], Callable[[Any], ros_types.StampedRosMessage]] = {
    **{kind: table.encode for kind, table in _TABLES.items()},
    DepthFrame: depth_on_the_wire,
    Event: _encode_event,
    ProcessStatus: _encode_status,
}
_DECODERS: dict[type, Callable[[Any], Message]] = {
    **{kind: table.decode for kind, table in _TABLES.items()},
    DepthFrame: decode_depth,
    Event: _decode_event,
    ProcessStatus: _decode_status,
}
_LIMITS = TemplateBounds(time_ns=(TIME_MIN_NS, TIME_MAX_NS), norm_squared=NORM_SQUARED)
_TEMPLATES: dict[type, Templates] = {
    kind: Templates(holes, fixed, reference_bytes, partial(reference_message, kind), _LIMITS)
    for kind, holes, fixed in (
        (DepthFrame, DEPTH_HOLES, DEPTH_FIXED),
        *((kind, table.holes, table.fixed) for kind, table in _TABLES.items()),
    )
}
