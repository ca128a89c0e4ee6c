"""Messages as CDR bytes of ROS 2 types, and back, with every check that a stranger's bytes need.

`decode` returns a message that is whole, finite and plausible, or raises `MessageError`: nothing
else, whatever the bytes. The envelope is the attachment of rmw_zenoh: sequence, capture time and
the identity of the sender.
"""

import dataclasses
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from operator import attrgetter
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from saltus.errors import MessageError
from saltus.wire import schemas
from saltus.wire.messages import DepthFrame, Event, Message, ProcessStatus
from saltus.wire.schemas import FIELDS, TYPE_NAME, Field

M = TypeVar("M", bound=Message)

PAYLOAD_MAX = 4 * 2**20  # bytes; a depth image of 1280x720 has 1.8 MB
WIDTH_MAX, HEIGHT_MAX = 1280, 720  # D435i datasheet: the largest depth image
DEPTH_UNIT_MAX_M = 0.1
FOCAL_MIN_PX, FOCAL_MAX_PX = 1.0, 3400.0
"""With a longer lens the widest image sees less than the heightmap model does, 21.4 degrees
across."""
CENTRE_MAX_PX = 1e5
NORM_TOLERANCE = 1e-2  # of a quaternion: drift of a float32 IMU is far below
TIME_MIN_NS = -(10**9)
TIME_MAX_NS = (2**31 - 1) * 10**9  # builtin_interfaces/Time counts seconds in an int32
ENCODING = "16UC1"
CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
LOG_INFO = 20  # rcl_interfaces/msg/Log
_NANO = 10**9

STORE = get_typestore(Stores.EMPTY)
for _name, _definition in {**schemas.STANDARD, **schemas.DEFINITIONS}.items():
    STORE.register(get_types_from_msg(_definition, _name))
_FORMER = {
    kind: tuple(f"{TYPE_NAME[kind]}Former{i}" for i in range(len(texts)))
    for kind, texts in schemas.FORMER.items()
}
for _kind, _names in _FORMER.items():
    for _name, _definition in zip(_names, schemas.FORMER[_kind], strict=True):
        STORE.register(get_types_from_msg(_definition, _name))
_HEADER: Any = STORE.types["std_msgs/msg/Header"]
_TIME: Any = STORE.types["builtin_interfaces/msg/Time"]
_IMAGE: Any = STORE.types["sensor_msgs/msg/Image"]
_CAMERA_INFO: Any = STORE.types["sensor_msgs/msg/CameraInfo"]
_REGION: Any = STORE.types["sensor_msgs/msg/RegionOfInterest"]
_ENVELOPE = struct.Struct("<qqB16s")
_SCALARS: dict[str, Callable[[Any], Any]] = {
    "string": lambda value: str(value)[: schemas.TEXT_MAX],
    "float64": float,
    "int64": int,
    "uint8": int,
    "bool": int,
}


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
        """Reads an attachment; `MessageError` "envelope" for a wrong length, or a sequence below 1."""
        if len(data) != _ENVELOPE.size:
            raise MessageError("envelope", f"{len(data)} bytes instead of {_ENVELOPE.size}")
        sequence, capture_ns, size, boot_id = _ENVELOPE.unpack(data)
        if size != 16 or sequence < 1:
            raise MessageError("envelope", f"identity of {size} bytes, sequence {sequence}")
        return cls(sequence, capture_ns, boot_id)


def encoding_of(kind: type[Message]) -> str:
    """The Zenoh encoding of a message: metadata for viewers."""
    return f"application/cdr;schema={TYPE_NAME[kind]}"


def definition_of(type_name: str) -> str:
    """The `ros2msg` schema text of a ROS 2 type with all that it contains."""
    return STORE.generate_msgdef(type_name, ros_version=2)[0]


def encode(message: Message) -> bytes:
    """Writes a message as CDR; `MessageError` where a field does not have the shape or type that travels.

    Values are checked by `decode`: what is sent is for the receiver to judge.
    """
    kind = type(message)
    try:
        wire = _ENCODERS[kind](message)
        return bytes(STORE.serialize_cdr(wire, TYPE_NAME[kind]))
    except MessageError:
        raise
    except Exception as error:
        raise MessageError("unencodable", f"{kind.__name__}: {error}") from error


def decode(kind: type[M], data: bytes) -> M:
    """Reads and checks a message. Arrays of the result are read-only.

    A `MessageError` has the reason "empty", "size", "malformed", "shape", "not_finite", "range",
    "enum" or "encoding".
    """
    if not data:
        raise MessageError("empty")
    if len(data) > PAYLOAD_MAX:
        raise MessageError("size", f"{len(data)} bytes, at most {PAYLOAD_MAX}")
    try:
        return cast(M, _DECODERS[kind](_parse(TYPE_NAME[cast(Any, kind)], data)))
    except MessageError:
        raise
    except Exception as error:  # the parser's errors on hostile bytes are of many types
        raise MessageError("malformed", f"{kind.__name__}: {error}") from error


def former_definitions_of(kind: type[Message]) -> list[str]:
    """The `ros2msg` schema texts of a message in older recordings, the newest first."""
    return [definition_of(name) for name in _FORMER.get(kind, ())]


def of_today(kind: type[Message], former: int, data: bytes) -> bytes:
    """The bytes of today for those of a message of an older recording, `former` in `former_definitions_of`.

    Raises:
        MessageError: they are none.
    """
    try:
        old, table = _parse(_FORMER[kind][former], data), _TABLES[kind]
        values = [
            getattr(old, f.name) if hasattr(old, f.name) else table.lacking(f.name)
            for f in table.fields
        ]
        return bytes(STORE.serialize_cdr(table.wire_type(old.header, *values), TYPE_NAME[kind]))
    except MessageError:
        raise
    except Exception as error:  # the parser's errors on hostile bytes are of many types
        raise MessageError("malformed", f"{kind.__name__}: {error}") from error


def stamp(time_ns: int) -> Any:
    """A `builtin_interfaces/msg/Time`."""
    return _TIME(*divmod(time_ns, _NANO))


def header(time_ns: int, frame: str) -> Any:
    """A `std_msgs/msg/Header`."""
    return _HEADER(stamp(time_ns), frame)


def _parse(type_name: str, data: bytes) -> Any:
    if data[:4] != CDR_LITTLE_ENDIAN:
        raise MessageError("malformed", "not little-endian CDR")
    definition = STORE.get_msgdef(type_name)
    wire, end = definition.deserialize_cdr_le(memoryview(data)[4:], 0, definition.cls, STORE)
    if end + 4 != len(data):
        raise MessageError("malformed", f"{len(data)} bytes where {end + 4} were announced")
    return wire


def _time_of(wire_time: Any) -> int:
    time_ns = wire_time.sec * _NANO + wire_time.nanosec
    if wire_time.nanosec >= _NANO or not TIME_MIN_NS <= time_ns <= TIME_MAX_NS:
        raise MessageError("range", f"time {wire_time.sec} s {wire_time.nanosec} ns")
    return time_ns


def _text(name: str, value: str) -> str:
    if len(value) > schemas.TEXT_MAX:
        raise MessageError("range", f"{name} has {len(value)} characters")
    return value


def _bounded(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        reason = "not_finite" if not np.isfinite(value) else "range"
        raise MessageError(reason, f"{name} = {value}, allowed {low} to {high}")


class _TableCodec:
    """Codec of a message that travels as the rows of `schemas.FIELDS` say."""

    def __init__(self, kind: type[Message]) -> None:
        self.kind: Any = kind
        self.wire_type: Any = STORE.types[TYPE_NAME[kind]]
        self.frame = schemas.FRAME[kind]
        self.fields = FIELDS[kind]
        self.values_of = attrgetter(*(f.name for f in self.fields))
        self.writers = [_writer(f) for f in self.fields]
        self.arrays = [f for f in self.fields if f.wire == "float64" and f.shape is not None]
        self.array_places = [i for i, f in enumerate(self.fields) if f in self.arrays]
        self.has_grid = any(f.name == "y" for f in self.arrays)
        shapes = [f.shape for f in self.arrays if f.shape is not None]
        self.in_rows = bool(shapes) and all(len(shape) > 1 for shape in shapes)
        self.varies = not self.in_rows and any(
            f.may_lack or schemas.ANY in (f.shape or ()) for f in self.arrays
        )
        self.low, self.high = self._bounds(
            () if self.varies or self.in_rows else tuple(map(math.prod, shapes))
        )

    def lacking(self, name: str) -> Any:
        """The value of a field, as it travels, that a message of before does not have."""
        if name == "x":
            return np.array(schemas.FORMER_GRID.x)
        known = next(f for f in dataclasses.fields(self.kind) if f.name == name)
        return (
            np.ravel(known.default_factory()) if callable(known.default_factory) else known.default
        )

    def encode(self, message: Any) -> Any:
        values = [
            write(value) for write, value in zip(self.writers, self.values_of(message), strict=True)
        ]
        if self.has_grid:
            self._check_points([values[i] for i in self.array_places])
        return self.wire_type(header(message.time_ns, self.frame), *values)

    def decode(self, wire: Any) -> Any:
        values: dict[str, Any] = {"time_ns": _time_of(wire.header.stamp)}
        for field, value in zip(self.fields, self.values_of(wire), strict=True):
            values[field.name] = _from_wire(field, value)
        self._check_arrays(values)
        return self.kind(**values)

    @lru_cache(maxsize=64)  # noqa: B019 - codecs live as long as the program
    def _bounds(self, sizes: tuple[int, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Bounds of all arrays of these lengths one after the other.

        One of each where there are none.
        """
        low, high = (
            np.array([getattr(f, end) for f in self.arrays], np.float64) for end in ("low", "high")
        )
        return (np.repeat(low, sizes), np.repeat(high, sizes)) if sizes else (low, high)

    def _check_points(self, arrays: list[Any]) -> None:
        """Refuses heights that do not stand on the grid of their message.

        Arrays as in `self.arrays`.
        """
        sizes = {
            f.name: array.size
            for f, array in zip(self.arrays, arrays, strict=True)
            if f.shape == (schemas.ANY,) and (array.size or not f.may_lack)
        }
        rows, columns = sizes.pop("x"), sizes.pop("y")
        points = rows * columns
        if not 1 <= points <= schemas.POINTS_MAX:
            raise MessageError(
                "shape", f"a grid of {rows} times {columns} points, at most {schemas.POINTS_MAX}"
            )
        for name, size in sizes.items():
            if size != points:
                raise MessageError("shape", f"{name} has {size} values on {points} points")

    def _check_arrays(self, values: dict[str, Any]) -> None:
        """All arrays at once; one by one only to name the culprit."""
        arrays = [values[f.name] for f in self.arrays]
        if not arrays:
            return
        low, high = self.low, self.high
        if self.in_rows:
            _check_rows(arrays)
            flat, low, high = (
                np.stack([array.ravel() for array in arrays]),
                low[:, None],
                high[:, None],
            )
        else:
            if self.has_grid:
                self._check_points(arrays)
            if self.varies:
                low, high = self._bounds(tuple(array.size for array in arrays))
            flat = np.concatenate([array.ravel() for array in arrays])
        inside = flat >= low
        inside &= flat <= high
        if np.count_nonzero(inside) < inside.size:
            for field, array in zip(self.arrays, arrays, strict=True):
                _check_values(field, array)
        if self.has_grid and any(
            (values[name][1:] <= values[name][:-1]).any() for name in ("x", "y")
        ):
            raise MessageError("range", "x and y of a grid must ascend")
        quaternion = values.get("quaternion_base_in_world")
        if quaternion is not None:
            _bounded(
                "|quaternion_base_in_world|^2",
                float(quaternion.dot(quaternion)),
                1 - NORM_TOLERANCE,
                1.02,
            )


def _writer(field: Field) -> Callable[[Any], Any]:
    """Turns a value of a message into what is serialised."""
    if field.shape is None:
        return _SCALARS[field.wire]
    shape, dtype = field.shape, np.bool_ if field.wire == "bool" else np.float64
    rows = -1 in shape

    def write(value: Any) -> Any:
        array: NDArray[Any] = np.ascontiguousarray(value, dtype)
        if field.may_lack and not array.size:
            return array.reshape(-1)
        if array.shape != shape and not (
            rows and array.ndim == len(shape) and array.shape[1:] == shape[1:]
        ):
            raise MessageError("shape", f"{field.name} has shape {array.shape} instead of {shape}")
        return array.reshape(-1) if rows else array

    return write


def _from_wire(field: Field, value: Any) -> Any:
    if field.shape is not None:
        if field.wire == "bool" and max(value.tobytes()) > 1:
            raise MessageError("range", f"{field.name} is neither true nor false")
        if field.may_lack and value.size and -1 not in field.shape and value.shape != field.shape:
            raise MessageError(
                "shape", f"{field.name} has {value.size} values, not {field.shape[0]} or none"
            )
        if -1 not in field.shape or len(field.shape) == 1:
            return value
        if value.size % field.shape[1]:
            raise MessageError(
                "shape", f"{field.name} has {value.size} values, not rows of {field.shape[1]}"
            )
        return value.reshape(field.shape)
    if field.enum is not None:
        try:
            return field.enum(value)
        except ValueError as error:
            raise MessageError("enum", f"{field.name} = {value}") from error
    if field.wire == "string":
        return _text(field.name, value)
    _bounded(field.name, value, field.low, field.high)
    return value


def _check_rows(arrays: list[Any]) -> None:
    rows = {len(array) for array in arrays}
    if len(rows) != 1 or not 1 <= min(rows) <= schemas.JOINT_ROWS_MAX:
        raise MessageError("shape", f"numbers of rows: {sorted(rows)}")


def _check_values(field: Field, array: Any) -> None:
    if not array.size:
        return
    if not (np.isfinite(array) | (array == field.high)).all():
        raise MessageError("not_finite", field.name)
    low, high = float(array.min()), float(array.max())
    if low < field.low or high > field.high:
        raise MessageError(
            "range", f"{field.name} in [{low}, {high}], allowed {field.low} to {field.high}"
        )


def depth_on_the_wire(message: DepthFrame) -> Any:
    """A depth image as it travels: with a `sensor_msgs/Image` and the `sensor_msgs/CameraInfo` that goes with it."""
    if message.depth.dtype != np.uint16 or message.depth.ndim != 2:
        raise MessageError(
            "shape", f"depth is {message.depth.dtype} of shape {message.depth.shape}"
        )
    height, width = message.depth.shape
    head = header(message.time_ns, schemas.FRAME[DepthFrame])
    pixels = np.ascontiguousarray(message.depth).view(np.uint8).reshape(-1)
    image = _IMAGE(head, height, width, ENCODING, 0, 2 * width, pixels)
    lens = _calibration(
        *(float(value) for value in (message.fx, message.fy, message.cx, message.cy))
    )
    info = _CAMERA_INFO(head, height, width, "plumb_bob", *lens, 0, 0, _REGION(0, 0, 0, 0, False))
    wire_type: Any = STORE.types[schemas.DEPTH_TYPE]
    return wire_type(head, image, info, float(message.depth_unit_m), int(message.frame_id))


@lru_cache(maxsize=16)
def _calibration(fx: float, fy: float, cx: float, cy: float) -> tuple[Any, ...]:
    """Distortion, intrinsics, rotation and projection of a `sensor_msgs/msg/CameraInfo`."""
    u, v = cx - 0.5, cy - 0.5  # ROS counts pixel centres at integers, this project at halves
    intrinsics = np.array([fx, 0, u, 0, fy, v, 0, 0, 1], np.float64)
    projection = np.array([fx, 0, u, 0, 0, fy, v, 0, 0, 0, 1, 0], np.float64)
    return np.zeros(5), intrinsics, np.eye(3).reshape(-1), projection


def _decode_depth(wire: Any) -> DepthFrame:
    image, info = wire.image, wire.camera_info
    if image.encoding != ENCODING or image.is_bigendian:
        raise MessageError(
            "encoding",
            f"{image.encoding!r}, big-endian {image.is_bigendian}: only {ENCODING} travels",
        )
    if not (1 <= image.height <= HEIGHT_MAX and 1 <= image.width <= WIDTH_MAX):
        raise MessageError(
            "shape", f"{image.width}x{image.height}, at most {WIDTH_MAX}x{HEIGHT_MAX}"
        )
    if image.step != 2 * image.width or image.data.size != image.step * image.height:
        raise MessageError("shape", f"{image.data.size} bytes for {image.width}x{image.height}")
    if (info.height, info.width) != (image.height, image.width):
        raise MessageError("shape", f"intrinsics are for {info.width}x{info.height}")
    fx, cx, fy, cy = (float(info.k[i]) for i in (0, 2, 4, 5))
    for name, value in (("fx", fx), ("fy", fy)):
        _bounded(name, value, FOCAL_MIN_PX, FOCAL_MAX_PX)
    for name, value in (("cx", cx), ("cy", cy)):
        _bounded(name, value, -CENTRE_MAX_PX, CENTRE_MAX_PX)
    _bounded("depth_unit_m", wire.depth_unit_m, 1e-6, DEPTH_UNIT_MAX_M)
    _bounded("frame_id", wire.frame_id, 0, schemas.INDEX_MAX)
    return DepthFrame(
        time_ns=_time_of(wire.header.stamp),
        frame_id=wire.frame_id,
        depth=image.data.view(np.uint16).reshape(image.height, image.width),
        depth_unit_m=wire.depth_unit_m,
        fx=fx,
        fy=fy,
        cx=cx + 0.5,
        cy=cy + 0.5,
    )


def _encode_event(message: Event) -> Any:
    text = message.detail[: schemas.TEXT_MAX]
    wire_type: Any = STORE.types[schemas.EVENT_TYPE]
    return wire_type(stamp(message.time_ns), LOG_INFO, message.process, text, "", message.code, 0)


def _decode_event(wire: Any) -> Event:
    process, code, detail = (
        _text("name", wire.name),
        _text("function", wire.function),
        _text("msg", wire.msg),
    )
    return Event(time_ns=_time_of(wire.stamp), process=process, code=code, detail=detail)


def _encode_status(message: ProcessStatus) -> Any:
    names, topics = list(message.rejected), list(message.received)
    wire_type: Any = STORE.types[schemas.STATUS_TYPE]
    return wire_type(
        header(message.time_ns, schemas.FRAME[ProcessStatus]),
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
        _bounded(name, value, 0, schemas.INDEX_MAX)
    return ProcessStatus(
        time_ns=_time_of(wire.header.stamp),
        process=_text("process", wire.process),
        ready=wire.ready,
        ticks=wire.ticks,
        overruns=wire.overruns,
        rejected=_counts("rejected", wire.rejected, wire.rejected_count),
        received=_counts("received", wire.received, wire.received_count),
        silence_us=_counts("silence_us", wire.received, wire.silence_us),
    )


def _counts(name: str, keys: Any, counts: Any) -> dict[str, int]:
    if len(keys) != counts.size:
        raise MessageError("shape", f"{name}: {len(keys)} names with {counts.size} counts")
    return {_text(name, key): int(count) for key, count in zip(keys, counts, strict=True)}


_TABLES = {kind: _TableCodec(kind) for kind in FIELDS}
_ENCODERS: dict[Any, Any] = {
    **{kind: table.encode for kind, table in _TABLES.items()},
    DepthFrame: depth_on_the_wire,
    Event: _encode_event,
    ProcessStatus: _encode_status,
}
_DECODERS: dict[Any, Any] = {
    **{kind: table.decode for kind, table in _TABLES.items()},
    DepthFrame: _decode_depth,
    Event: _decode_event,
    ProcessStatus: _decode_status,
}
