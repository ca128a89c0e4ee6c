"""Types of ROS 2 as DDS knows them.

Payloads are CDR that is made and read elsewhere. Cyclone is told the types only so that others can
compare them: with octets for every uint8, as a type of Cyclone 11's own that 0.10 does not know
makes a peer of 0.10 end with a segmentation fault as soon as it hears of it.
"""

from functools import cache
from typing import Any

from cyclonedds.idl import make_idl_struct, types
from cyclonedds.idl.annotations import final

from saltus.recordings import ros_messages as ros
from saltus.wire.ros2_node import dds_name

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
    """The type as Cyclone knows it, for samples that are whole payloads (bytes):
    Cyclone neither makes nor reads their fields.
    """
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
