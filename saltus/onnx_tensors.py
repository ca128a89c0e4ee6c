"""Tensors of an ONNX file whose values lie in another file: found without the package `onnx`.

ONNX Runtime reads such a file from the folder in which a program happens to run, and no checksum
covers it. An ONNX file is a protobuf message; numbers of fields are those of onnx.proto, which
never change (https://github.com/onnx/onnx/blob/main/onnx/onnx.proto).
"""

from collections.abc import Iterator

_PARTS = {
    "model": {7: "graph", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node", 11: "attribute"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {13: "place"},
}
"""Fields of each kind of message that may lead to a tensor or its place, and their kinds."""
_DATA_LOCATION, _EXTERNAL = 14, 1
_VARINT, _BYTES = 0, 2
_FIXED_SIZES = {1: 8, 5: 4}  # of the other types of the wire format that are in use
_KEY, _VALUE = 1, 2


def external_files(data: bytes) -> list[str]:
    """Names of the files that hold values of a model's tensors; `?` of one that is not named.

    Empty where all values lie in the model itself.

    Raises:
        ValueError: the bytes are no protobuf message, as those of no ONNX file.
    """
    found: set[str] = set()
    waiting = [("model", memoryview(data))]
    while waiting:
        kind, message = waiting.pop()
        parts, is_external, place = _PARTS[kind], False, "?"
        for number, value in _fields(message):
            if isinstance(value, int):
                is_external |= kind == "tensor" and (number, value) == (_DATA_LOCATION, _EXTERNAL)
            elif number in parts and parts[number] == "place":
                entry = dict(_fields(value))
                name = entry.get(_VALUE)
                if entry.get(_KEY) == b"location" and isinstance(name, memoryview):
                    place = bytes(name).decode(errors="replace")
            elif number in parts:
                waiting.append((parts[number], value))
        if is_external:
            found.add(place)
    return sorted(found)


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Number and value of each field; numbers of fixed size are bytes, as nobody asks for them."""
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        kind = tag & 7
        if kind == _VARINT:
            value, at = _varint(message, at)
            yield tag >> 3, value
            continue
        if kind == _BYTES:
            size, at = _varint(message, at)
        elif kind in _FIXED_SIZES:
            size = _FIXED_SIZES[kind]
        else:
            raise ValueError(f"no protobuf message: a field of type {kind}")
        if at + size > len(message):
            raise ValueError("it ends too early")
        yield tag >> 3, message[at : at + size]
        at += size


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """A number of variable length, and where the next field begins."""
    number = 0
    for shift in range(0, 70, 7):
        if at >= len(message):
            raise ValueError("it ends too early")
        number |= (message[at] & 0x7F) << shift
        at += 1
        if message[at - 1] < 0x80:
            return number, at
    raise ValueError("no protobuf message: a number without an end")
