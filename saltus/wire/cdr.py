"""ROS 2 types as CDR bytes: the store of those that travel, and the checks of their parts."""

from collections.abc import Callable
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from saltus.errors import MessageError
from saltus.wire import schemas
from saltus.wire.ros_types import RosHeader, RosTime
from saltus.wire.schemas import TYPE_NAME

TIME_MIN_NS = -(10**9)
TIME_MAX_NS = (2**31 - 1) * 10**9  # builtin_interfaces/Time counts seconds in an int32
CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_NANO = 10**9

STORE = get_typestore(Stores.EMPTY)
for _name, _definition in {**schemas.STANDARD, **schemas.DEFINITIONS}.items():
    STORE.register(get_types_from_msg(_definition, _name))
FORMER = {
    kind: tuple(f"{TYPE_NAME[kind]}Former{i}" for i in range(len(texts)))
    for kind, texts in schemas.FORMER.items()
}
"""Names, in the store, of the types of older recordings."""
for _kind, _names in FORMER.items():
    for _name, _definition in zip(_names, schemas.FORMER[_kind], strict=True):
        STORE.register(get_types_from_msg(_definition, _name))
_HEADER: Callable[..., RosHeader] = STORE.types["std_msgs/msg/Header"]
_TIME: Callable[..., RosTime] = STORE.types["builtin_interfaces/msg/Time"]


def ros2msg_definition(type_name: str) -> str:
    """The `ros2msg` schema text of a ROS 2 type with all that it contains."""
    return STORE.generate_msgdef(type_name, ros_version=2)[0]


def make_ros_time(time_ns: int) -> RosTime:
    """A `builtin_interfaces/msg/Time`."""
    return _TIME(*divmod(time_ns, _NANO))


def make_ros_header(time_ns: int, frame: str) -> RosHeader:
    """A `std_msgs/msg/Header`."""
    return _HEADER(make_ros_time(time_ns), frame)


def parse_ros_message(type_name: str, data: bytes) -> Any:
    """A message of the store of a stranger's bytes; they may raise whatever they like."""
    if data[:4] != CDR_LITTLE_ENDIAN:
        raise MessageError("malformed", "not little-endian CDR")
    definition = STORE.get_msgdef(type_name)
    wire, end = definition.deserialize_cdr_le(memoryview(data)[4:], 0, definition.cls, STORE)
    if end + 4 != len(data):
        raise MessageError("malformed", f"{len(data)} bytes where {end + 4} were announced")
    return wire


def time_of(wire_time: RosTime) -> int:
    """Nanoseconds of a `builtin_interfaces/msg/Time`; `MessageError` where it is not plausible."""
    time_ns = wire_time.sec * _NANO + wire_time.nanosec
    if wire_time.nanosec >= _NANO or not TIME_MIN_NS <= time_ns <= TIME_MAX_NS:
        raise MessageError("range", f"time {wire_time.sec} s {wire_time.nanosec} ns")
    return time_ns


def checked_text(name: str, value: str) -> str:
    """The text; `MessageError` where it is too long."""
    if len(value) > schemas.TEXT_MAX:
        raise MessageError("range", f"{name} has {len(value)} characters")
    return value


def check_bounded(name: str, value: float, low: float, high: float) -> None:
    """Refuses a number outside of its bounds by a `MessageError`."""
    if not low <= value <= high:
        reason = "not_finite" if not np.isfinite(value) else "range"
        raise MessageError(reason, f"{name} = {value}, allowed {low} to {high}")
