"""Messages of one kind by templates: the codec's own bytes of a sample,
with holes for what changes.

Field by field, reading and writing a message takes longer than most of what is done with it. But
messages with the same texts and the same lengths of arrays differ in some known places alone. A
`Template` finds these places by itself: for each hole it encodes the sample with two values of
which all bits differ. So the codec stays the one text of the format, and the reference: whatever
fits no template, or is not plausible, it judges.
"""

import struct
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np

from saltus.errors import MessageError
from saltus.wire.messages import Message

CDR_HEAD = 4
"""Bytes before the body of a message; numbers are aligned from there on."""
TEMPLATES_MAX = 64
"""Templates of one kind; a run has a few, for its statuses and texts."""
OF_ONE_LENGTH_MAX = 4
_NANO = 10**9
_STAMP = struct.Struct("<iI")
_TIMES = tuple(0x01010101 * digit * (_NANO + 1) for digit in (1, 2))
"""Times [ns] of which all bytes differ, those of the seconds and of the nanoseconds."""
_UNLIKE = tuple(bytes([byte]) for byte in (0x55, 0xAA))
"""Bytes of which all bits differ."""


@dataclass(frozen=True)
class TemplateHole:
    """A field that changes from message to message."""

    name: str
    dtype: str
    """As numpy has it: f8, i8, b1 (bool) or u2."""
    is_array: bool
    varies: bool
    """True for arrays of any length."""
    write: Callable[[Any], Any]
    """Makes what is written of a value, or raises."""
    low: float = 0.0
    """Bounds of numbers of eight bytes."""
    high: float = 0.0

    def unlike(self, value: Any) -> list[Any]:
        """Two values as long as this one, of which all bits differ."""
        if not self.is_array:
            return [np.frombuffer(byte * 8, self.dtype)[0].item() for byte in _UNLIKE]
        size, shape = value.nbytes, value.shape
        return [np.frombuffer(byte * size, self.dtype).reshape(shape) for byte in _UNLIKE]


@dataclass(frozen=True)
class TemplateBounds:
    """Bounds that are not those of one hole."""

    time_ns: tuple[int, int]
    norm_squared: tuple[float, float]
    """Least and greatest one of its quaternion, where a message has one."""
    quaternion: str = "quaternion_base_in_world"


@dataclass(frozen=True)
class TemplatePart:
    """Bytes from start to end: a hole, the time, or what all messages have in common."""

    start: int
    end: int
    hole: TemplateHole | None = None
    shape: tuple[int, ...] = ()
    """Shape of the hole's array."""
    is_time: bool = False

    @property
    def code(self) -> str:
        """Part as `struct` has it."""
        if self.hole is None or self.hole.is_array:
            return f"{self.end - self.start}s"
        return {"f8": "d", "i8": "q"}[self.hole.dtype]

    @property
    def is_view(self) -> bool:
        """True where it is read as a view on the bytes."""
        return self.hole is not None and self.hole.is_array and self.hole.dtype != "b1"

    @property
    def doubles(self) -> slice:
        """Where it lies in the body, in numbers of eight bytes."""
        return slice((self.start - CDR_HEAD) // 8, (self.end - CDR_HEAD) // 8)


class Template:
    """All messages that differ from a sample in their time and in holes alone.

    Args:
        sample: A message; its arrays are kept.
        holes: Of its kind.
        encode: The reference.
        limits: Of its kind.
    """

    def __init__(
        self,
        sample: Message,
        holes: tuple[TemplateHole, ...],
        encode: Callable[[Message], bytes],
        limits: TemplateBounds,
    ) -> None:
        self._kind, self._limits, data = type(sample), limits, encode(sample)
        parts = [
            TemplatePart(start, end, is_time=True)
            for start, end in _differing(*(encode(replace(sample, time_ns=t)) for t in _TIMES))
        ]
        for hole in holes:
            value = getattr(sample, hole.name)
            ends = _differing(
                *(encode(replace(sample, **{hole.name: v})) for v in hole.unlike(value))
            )
            parts += [TemplatePart(start, end, hole, np.shape(value)) for start, end in ends]
        parts = _with_gaps(parts, len(data))
        self._fixed = dict(vars(sample))
        self._same = [data[p.start : p.end] for p in parts if p.hole is None and not p.is_time]
        self._plan_writing(parts)
        self._plan_reading(parts)

    def _plan_writing(self, parts: list[TemplatePart]) -> None:
        self._holes = [p.hole for p in parts if p.hole is not None]
        self._values_of = attrgetter("time_ns", *(hole.name for hole in self._holes))
        self._writer = struct.Struct("<" + "".join(part.code for part in parts))
        holes, same = iter(range(1, len(parts))), iter(range(1 + len(self._holes), 2 * len(parts)))
        order = [0 if p.is_time else next(same if p.hole is None else holes) for p in parts]
        self._in_order = itemgetter(*order)

    def write(self, message: Message) -> bytes:
        """The bytes of a message."""
        time_ns, *values = self._values_of(message)
        items = [
            hole.write(value).tobytes() if hole.is_array else hole.write(value)
            for hole, value in zip(self._holes, values, strict=True)
        ]
        stamp = _STAMP.pack(*divmod(time_ns, _NANO))
        return self._writer.pack(*self._in_order([stamp, *items, *self._same]))

    def _plan_reading(self, parts: list[TemplatePart]) -> None:
        codes = [f"{p.end - p.start}x" if p.is_view else p.code for p in parts]
        self._reader = struct.Struct("<" + "".join(codes))
        row = list(enumerate(p for p in parts if not p.is_view))
        self._time, *self._further_times = (i for i, p in row if p.is_time)
        same = [i for i, p in row if p.hole is None and not p.is_time]
        self._same_in = itemgetter(*same, same[0])  # of two or more it makes a tuple
        self._same_read = (*self._same, self._same[0])
        numbers = [(p.hole, i) for i, p in row if p.hole is not None]
        self._flags = [(h.name, i) for h, i in numbers if h.dtype == "b1"]
        self._doubles = [(h.name, i) for h, i in numbers if h.dtype == "f8"]
        self._integers = [(h.name, i, h.low, h.high) for h, i in numbers if h.dtype == "i8"]
        arrays = [(p.hole, p) for p in parts if p.hole is not None and p.is_view]
        self._pixels = [(h.name, p.start, p.shape) for h, p in arrays if h.dtype == "u2"]
        self._arrays = [(h.name, p.doubles, p.shape) for h, p in arrays if h.dtype == "f8"]
        judged = [(p.hole, p.doubles) for p in parts if p.hole is not None and p.hole.dtype == "f8"]
        sizes = [place.stop - place.start for _, place in judged]
        self._judged = np.concatenate(
            [np.arange(place.start, place.stop) for _, place in judged] or [np.zeros(0, np.intp)]
        )
        self._low = np.repeat([hole.low for hole, _ in judged], sizes)
        self._high = np.repeat([hole.high for hole, _ in judged], sizes)

    def read(self, data: bytes) -> Message | None:
        """The message of as many bytes; None where the reference has to judge."""
        row = self._reader.unpack(data)
        if self._same_in(row) != self._same_read:
            return None
        seconds, nanoseconds = _STAMP.unpack(row[self._time])
        time_ns, (earliest, latest) = seconds * _NANO + nanoseconds, self._limits.time_ns
        if nanoseconds >= _NANO or not earliest <= time_ns <= latest:
            return None
        if any(row[i] != row[self._time] for i in self._further_times):
            return None
        values = self._fixed.copy()
        values["time_ns"] = time_ns
        for name, place, low, high in self._integers:
            number = values[name] = row[place]
            if not low <= number <= high:
                return None
        for name, place in self._doubles:
            values[name] = row[place]
        for name, place in self._flags:
            if max(row[place]) > 1:
                return None
            values[name] = np.frombuffer(row[place], np.bool_)
        for name, start, shape in self._pixels:
            values[name] = np.frombuffer(data, np.uint16, shape[0] * shape[1], start).reshape(shape)
        if self._judged.size and not self._read_doubles(data, values):
            return None
        # As the constructor of a frozen dataclass does, which calls a function for each field
        message = object.__new__(self._kind)
        message.__dict__.update(values)
        return message

    def _read_doubles(self, data: bytes, values: dict[str, Any]) -> bool:
        """Adds arrays of doubles to values; True where all doubles are within their bounds."""
        body = data[CDR_HEAD:]  # a copy, in which they are aligned
        doubles = np.frombuffer(body, np.float64, len(body) // 8)
        judged = doubles[self._judged]
        if not ((judged >= self._low).all() and (judged <= self._high).all()):
            return False
        for name, span, shape in self._arrays:
            values[name] = doubles[span] if len(shape) == 1 else doubles[span].reshape(shape)
        quaternion = values.get(self._limits.quaternion)
        least, greatest = self._limits.norm_squared
        return quaternion is None or bool(least <= quaternion.dot(quaternion) <= greatest)


def _differing(one: bytes, other: bytes) -> list[tuple[int, int]]:
    """Where the bytes differ: start and end of each run."""
    differs = np.frombuffer(one, np.uint8) != np.frombuffer(other, np.uint8)
    edges = np.flatnonzero(np.diff(differs, prepend=False, append=False)).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def _with_gaps(parts: list[TemplatePart], length: int) -> list[TemplatePart]:
    """All bytes in order: these parts, and what lies between them."""
    whole, last = list[TemplatePart](), 0
    for part in [*sorted(parts, key=lambda part: part.start), TemplatePart(length, length)]:
        whole += [TemplatePart(last, part.start)] if part.start > last else []
        whole += [part] if part.end > part.start else []
        last = part.end
    return whole


class Templates:
    """Reads and writes messages of one kind, by templates of those that have come before.

    Args:
        holes: Of the kind.
        fixed: Names of the fields that are no hole.
        encode: The reference.
        decode: The reference.
        limits: Of the kind.
    """

    def __init__(
        self,
        holes: tuple[TemplateHole, ...],
        fixed: tuple[str, ...],
        encode: Callable[[Message], bytes],
        decode: Callable[[bytes], Message],
        limits: TemplateBounds,
    ) -> None:
        self._holes, self._encode, self._decode, self._limits = holes, encode, decode, limits
        self._fixed, self._varying = fixed, [hole.name for hole in holes if hole.varies]
        self._templates: dict[Hashable, Template | None] = {}
        """By what their messages have in common; None after the first of them."""
        self._by_length: dict[int, list[Template]] = {}

    def encode(self, message: Message) -> bytes:
        """Bytes of a message, the same as the codec's; raises what the codec raises."""
        template = self._template_of(message)
        return self._encode(message) if template is None else template.write(message)

    def decode(self, data: bytes) -> Any:
        """The message in some bytes, the same as the codec's; raises what the codec raises."""
        for template in self._by_length.get(len(data), ()):
            message = template.read(data)
            if message is not None:
                return message
        message = self._decode(data)
        known = self._template_of(message)
        if known is not None and known.write(message) == data:  # not one of another writer
            alike = self._by_length.setdefault(len(data), [])
            if known not in alike:
                alike.insert(0, known)
                del alike[OF_ONE_LENGTH_MAX:]
        return message

    def _template_of(self, message: Message) -> Template | None:
        """The template of a message; made of the second that has it,
        as some texts never come again.
        """
        key = self._key(message)
        template = self._templates.get(key)
        if template is None and key in self._templates:
            template = self._templates[key] = self._made(message)
        elif template is None:
            if len(self._templates) >= TEMPLATES_MAX:
                self._templates.clear()
                self._by_length.clear()
            self._templates[key] = None
        return template

    def _made(self, message: Message) -> Template | None:
        try:
            sample = self._decode(self._encode(message))
        except MessageError:  # who sends it, or who reads it, is told
            return None
        return Template(sample, self._holes, self._encode, self._limits)

    def _key(self, message: Message) -> Hashable:
        """Texts, statuses, what else is fixed, and lengths:
        messages of one template have the same.
        """
        fixed = (getattr(message, name) for name in self._fixed)
        return (
            *((v.dtype, v.shape, v.tobytes()) if isinstance(v, np.ndarray) else v for v in fixed),
            *(np.shape(getattr(message, name)) for name in self._varying),
        )
