"""The definitions of `ros_texts` as OMG IDL, with the names that ROS 2 gives types in DDS."""

import re

from ros_texts import TEXTS

BASE = {
    "bool": "boolean", "uint8": "octet", "uint16": "unsigned short", "int32": "long",
    "uint32": "unsigned long",
    "float32": "float", "float64": "double", "string": "string",
}  # fmt: skip
FIELD = re.compile(r"^([\w/]+)(\[(\d*)\])? (\w+)( .*)?$")


def idl() -> str:
    """All of them; a type comes after those that it contains."""
    written: dict[str, str] = {}
    for name in TEXTS:
        _write(name, written)
    return "\n".join([*written.values(), ""])


def _write(name: str, written: dict[str, str]) -> None:
    if name in written:
        return
    package, _, short = name.split("/")
    members = []
    for line in TEXTS[name].splitlines():
        if "=" in line:
            continue  # a constant
        kind, array, count, field, _ = FIELD.fullmatch(line).groups()  # type: ignore[union-attr]
        if kind not in BASE:
            full = "/".join([*(kind.split("/")[:-1] or [package]), "msg", kind.split("/")[-1]])
            _write(full, written)
            inner = f"{full.split('/')[0]}::msg::dds_::{full.split('/')[-1]}_"
        else:
            inner = BASE[kind]
        size = f"[{count}]" if array else ""
        members.append(
            f"sequence<{inner}> {field};" if array == "[]" else f"{inner} {field}{size};"
        )
    body = " ".join(members)
    written[name] = (
        f"module {package} "
        f"{{ module msg {{ module dds_ {{ @final struct {short}_ {{ {body} }}; }}; }}; }};"
    )
