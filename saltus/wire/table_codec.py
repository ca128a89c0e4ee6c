"""The codec of messages that travel as the rows of `schemas.FIELDS` say."""

import dataclasses
import math
from collections.abc import Callable
from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saltus.arrays import AnyArray
from saltus.errors import MessageError
from saltus.wire import ros_types, schemas
from saltus.wire.cdr import STORE, check_bounded, checked_text, make_ros_header, time_of
from saltus.wire.message_templates import TemplateHole
from saltus.wire.messages import Message
from saltus.wire.schemas import FIELDS, TYPE_NAME, MessageField

NORM_SQUARED = (0.99, 1.02)  # of a quaternion: drift of a float32 IMU is far below
_DTYPES = {"float64": "f8", "int64": "i8", "bool": "b1"}
_SCALARS: dict[str, Callable[[Any], Any]] = {
    "string": lambda value: str(value)[: schemas.TEXT_MAX],
    "float64": float,
    "int64": int,
    "uint8": int,
    "bool": int,
}


class TableCodec:
    """Codec of a message that travels as the rows of `schemas.FIELDS` say."""

    def __init__(self, kind: type[Message]) -> None:
        self.kind = kind
        self.wire_type: Callable[..., ros_types.StampedRosMessage] = STORE.types[TYPE_NAME[kind]]
        self.frame = schemas.FRAME[kind]
        self.fields = FIELDS[kind]
        self.values_of = attrgetter(*(f.name for f in self.fields))
        self.writers = [writer_of(f) for f in self.fields]
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

    @property
    def holes(self) -> tuple[TemplateHole, ...]:
        """Fields that change from message to message."""
        return tuple(
            TemplateHole(
                name=f.name,
                dtype=_DTYPES[f.wire],
                is_array=f.shape is not None,
                varies=f.shape is not None and (schemas.ANY in f.shape or f.may_lack),
                write=write,
                low=f.low,
                high=f.high,
            )
            for f, write in zip(self.fields, self.writers, strict=True)
            if f.name not in self.fixed
        )

    @property
    def fixed(self) -> tuple[str, ...]:
        """Texts, statuses and the grid, which stay for many messages."""
        return tuple(
            f.name
            for f in self.fields
            if f.wire == "string" or f.enum is not None or (self.has_grid and f.name in ("x", "y"))
        )

    def lacking(self, name: str) -> object:
        """The value of a field, as it travels, that a message of before does not have."""
        if name == "x":
            return np.array(schemas.FORMER_GRID.x)
        known = next(f for f in dataclasses.fields(self.kind) if f.name == name)
        return (
            np.ravel(known.default_factory()) if callable(known.default_factory) else known.default
        )

    def encode(self, message: Message) -> ros_types.StampedRosMessage:
        """A message as it travels; `MessageError` where a field has another shape."""
        values = [
            write(value) for write, value in zip(self.writers, self.values_of(message), strict=True)
        ]
        if self.has_grid:
            self._check_points([values[i] for i in self.array_places])
        return self.wire_type(make_ros_header(message.time_ns, self.frame), *values)

    def decode(self, wire: ros_types.StampedRosMessage) -> Message:
        """The message of what travels; `MessageError` where it is not plausible."""
        values: dict[str, Any] = {"time_ns": time_of(wire.header.stamp)}
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

    def _check_points(self, arrays: list[AnyArray]) -> None:
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
            check_bounded(
                "|quaternion_base_in_world|^2",
                float(quaternion.dot(quaternion)),
                *NORM_SQUARED,
            )


def writer_of(field: MessageField) -> Callable[[Any], Any]:
    """Turns a value of a message into what is serialised."""
    if field.shape is None:
        return _SCALARS[field.wire]
    shape, dtype = field.shape, np.bool_ if field.wire == "bool" else np.float64
    rows = -1 in shape

    def write(value: ArrayLike) -> AnyArray:
        array: AnyArray = np.ascontiguousarray(value, dtype)
        if field.may_lack and not array.size:
            return array.reshape(-1)
        if array.shape != shape and not (
            rows and array.ndim == len(shape) and array.shape[1:] == shape[1:]
        ):
            raise MessageError("shape", f"{field.name} has shape {array.shape} instead of {shape}")
        return array.reshape(-1) if rows else array

    return write


def _from_wire(field: MessageField, value: Any) -> Any:
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
        return checked_text(field.name, value)
    check_bounded(field.name, value, field.low, field.high)
    return value


def _check_rows(arrays: list[AnyArray]) -> None:
    rows = {len(array) for array in arrays}
    if len(rows) != 1 or not 1 <= min(rows) <= schemas.JOINT_ROWS_MAX:
        raise MessageError("shape", f"numbers of rows: {sorted(rows)}")


def _check_values(field: MessageField, array: AnyArray) -> None:
    if not array.size:
        return
    if not (np.isfinite(array) | (array == field.high)).all():
        raise MessageError("not_finite", field.name)
    low, high = float(array.min()), float(array.max())
    if low < field.low or high > field.high:
        raise MessageError(
            "range", f"{field.name} in [{low}, {high}], allowed {field.low} to {field.high}"
        )
