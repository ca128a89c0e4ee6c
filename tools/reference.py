"""Writes the reference pages, which are made from the code:
docs/reference/effects.md and messages.md.

python tools/reference.py        # a test fails where a page is not what this writes
"""

import ast
import inspect
import math
import textwrap
from collections.abc import Iterator
from dataclasses import Field, fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import tomli_w

from saltus.effects.effect import Effect
from saltus.effects.profile import EFFECTS, PARTS
from saltus.heightmap.service import proprioception_vector
from saltus.recordings import viewer
from saltus.robots.robot import JOINTS
from saltus.wire import depth_codec, messages, schemas
from saltus.wire.events import CODES
from saltus.wire.topics import TOPICS

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "reference"
MADE = "<!-- Made from the code by tools/reference.py. -->"
STATE = {field.name for field in schemas.FIELDS[messages.RobotState]}
ON_THE_WIRE = {
    messages.DepthFrame: "The image is 16UC1, depth along the optical axis in units of "
    "`depth_unit_m`: 0 is invalid, 65535 is nothing within range. The intrinsics are in "
    "`camera_info.k`, as in ROS: pixel (u, v) looks through "
    "((u - cx) / fx, (v - cy) / fy). Distortion is not read: images must be rectified. `frame_id` "
    "counts the images. "
    "Refused are other encodings, big-endian ones, a `step` other than two bytes a pixel, images "
    "over "
    f"{depth_codec.WIDTH_MAX} x {depth_codec.HEIGHT_MAX}, a `camera_info` of another size, focal "
    "lengths outside of "
    f"{depth_codec.FOCAL_MIN_PX:g} to {depth_codec.FOCAL_MAX_PX:g} pixels, and units outside of "
    f"1e-6 to {depth_codec.DEPTH_UNIT_MAX_M:g} m.",
    messages.Event: "`stamp` is its time, `name` the sender, `function` the code, `msg` the "
    "detail, for people. Details that are read: of `kill` the name of a process, of `blind` "
    "seconds, of `push` Ns, negative to the right.",
}
"""Messages whose fields travel in another form than they have in Python."""
PART_TITLES = {
    "actuator": "Drives (`[actuator]`)",
    "body": "Body (`[body]`)",
    "imu": "IMU (`[imu]`)",
    "camera": "Camera (`[camera]`)",
    "heightmap": "Heights that a planner is given (`[heightmap]`)",
}


def pages() -> dict[str, str]:
    """Text of each page, by its file's name."""
    return {"effects.md": effects_page(), "messages.md": messages_page()}


def effects_page() -> str:
    """Every effect of a profile."""
    parts = [
        f"# Effects\n\n{MADE}",
        "A profile is a TOML file that says how hardware differs from the ideal: `--profile "
        "FILE.toml`, or a name "
        "under `profiles/`. Each effect is one table below its part, `[actuator.torque_gain]`. "
        "What is left out has no "
        "effect. Where *joints* is yes, a parameter is one number for all joints, or a list of 12 "
        "in the order "
        f"{', '.join(JOINTS[:3])}, ... of the legs FR, FL, RR, RL. `saltus real2sim apply` writes "
        "such files.",
    ]
    for part, title in PART_TITLES.items():
        parts.append(f"## {title}")
        parts += [_effect(kind) for kind in EFFECTS.values() if PARTS[kind.site] == part]
    parts += [
        "## A profile to copy",
        "The one that the shipped robot has is `saltus/robots/go1/profile.toml`. This one has "
        "every "
        "effect of one number at the value at which it does nothing: keep what you need.",
        f"```toml\n{null_profile()}```",
    ]
    return "\n\n".join(_wrapped(part) for part in parts) + "\n"


def null_profile() -> str:
    """A profile in TOML with every effect of plain numbers,
    each at the value at which it changes nothing.
    """
    table: dict[str, dict[str, Any]] = {part: {} for part in PART_TITLES}
    for kind in EFFECTS.values():
        values = {
            f.name: f.metadata["null"]
            for f in fields(kind)
            if isinstance(f.metadata.get("null"), float)
        }
        if values:
            table[PARTS[kind.site]][kind.name] = values
    return tomli_w.dumps({part: effects for part, effects in table.items() if effects})


def _effect(kind: type[Effect]) -> str:
    rows = [_parameter(f) for f in fields(kind) if "low" in f.metadata]
    head = "| parameter | unit | no effect at | from | to | joints |\n|---|---|---|---|---|---|"
    return f"### {kind.name}\n\n{_wrapped(_text(kind))}\n\n{head}\n" + "\n".join(rows)


def _parameter(f: "Field[Any]") -> str:
    m = f.metadata
    null = (
        "the robot's own"
        if "robot" in m
        else _shown(m["null"])
        if "null" in m
        else f"(default {_shown(f.default)})"
    )
    joints = "yes" if m["per_joint"] else ""
    return (
        f"| `{f.name}` | {m['unit']} | {null} | {_shown(m['low'])} | "
        f"{_shown(m['high'])} | {joints} |"
    )


def _read_by_the_network() -> list[str]:
    """Fields of a state that make the network's proprioception,
    in the order in which it reads them.
    """
    law = ast.parse(inspect.getsource(proprioception_vector.proprioception_of_states))
    read = [each for each in ast.walk(law) if isinstance(each, ast.Attribute)]
    names = {each.attr: each.lineno for each in read if ast.unparse(each.value) == "states"}
    return sorted(names.keys() & STATE, key=names.__getitem__)


def messages_page() -> str:
    """Every topic, and every message with its fields."""
    parts = [
        f"# Messages\n\n{MADE}",
        "`saltus router --out runs/mine` writes `runs/mine/client.json5`, which a Zenoh library "
        "(1.10 or later) loads "
        "as its configuration; it names a Unix socket, and that transport must be in the library "
        "([your robot](../tutorials/service.md), [over a "
        "network](../reliability.md#over-a-network)). "
        "`examples/own_robot.py` sends and reads messages without Saltus.",
        "Keys are `PREFIX/TOPIC`, e.g. `robot/0/camera/depth`. For `done`, `event` and `status` "
        "the sender's name "
        "follows: subscribe to `robot/0/status/*`. What an operator asks goes to "
        "`robot/0/event/operator`. Images of a second camera come under "
        "`robot/0/camera/depth/NAME`.",
        "Payloads are CDR of the ROS 2 types below, little-endian: they begin with the bytes 00 01 "
        "00 00, and nothing "
        "may follow the last field. Attachments are those of rmw_zenoh, 33 bytes without gaps: "
        "int64 sequence from 1, "
        "int64 capture time [ns], the byte 16, and 16 bytes that name the sender anew at each "
        "start.",
        "The table is `saltus/wire/topics.py`; limits of age are checked by whoever uses a "
        "message.",
        _topics(),
        _wrapped(textwrap.dedent(messages.__doc__ or "").split("\n\n", 1)[1]),
        "## What the heightmap network reads",
        "Of `controller/state`: "
        + ", ".join(f"`{name}`" for name in _read_by_the_network())
        + ", and the capture time in the header. Of `camera/depth`: the image, its intrinsics, "
        "unit and capture time. Besides these the service needs `step`, which must rise with each "
        "state, and `frame_id`, which must rise by "
        "one with each image: images that are left out count as lost, and what does not rise is "
        "not taken. If your "
        "counters start anew, take new bytes of the sender. All other fields may be zero. "
        "Quaternions must have length "
        "1. All joint angles are 0 where a leg hangs straight down; their signs are in the card of "
        "the network "
        "(`models/heightmap.md`). `leg_trusted` says which feet surely stand: where the "
        "phases of a leg controller are not known, take legs whose feet bear weight; a foot that "
        "is said to stand and "
        "does not is taken for ground, while false for all legs only means that feet tell nothing "
        "of the ground.",
    ]
    for kind in dict.fromkeys(topic.message for topic in TOPICS.values()):
        parts.append(_message(kind))
        if kind is messages.Event:
            parts += ["### Codes of events", _codes()]
    parts += _derived()
    return "\n\n".join(_wrapped(part) for part in parts) + "\n"


def _topics() -> str:
    head = (
        "| topic | message | who sends it | rate [Hz] | age on time [ms] | "
        "not used when older than [ms] |\n"
    )
    rows = []
    for t in TOPICS.values():
        sender = "every process" if t.publisher == "*" else t.publisher
        numbers = (
            _shown(t.rate_hz) if t.rate_hz else "",
            _shown(1e3 * t.nominal_age_s),
            _shown(1e3 * t.invalid_age_s),
        )
        cells = (f"`{t.name}`", f"`{schemas.TYPE_NAME[t.message]}`", sender, *numbers)
        rows.append(f"| {' | '.join(cells)} |")
    return head + "|---|---|---|---|---|---|\n" + "\n".join(rows)


def _codes() -> str:
    rows = (f"| `{code}` | {who} | {what} |" for code, (who, what) in CODES.items())
    return "| code | who sends it | what it says |\n|---|---|---|\n" + "\n".join(rows)


def _derived() -> list[str]:
    rows = [
        f"| `{name}` | `{type_name}` | {what} |"
        for name, (type_name, what) in viewer.TOPICS.items()
    ]
    numbers = [f"| `{name}` | {kind} | {meaning} |" for kind, name, meaning in viewer.NUMBERS]
    return [
        "## Derived for viewers",
        "Recordings hold these too; they are not on the bus. Made by "
        "`saltus/recordings/viewer.py`, in ROS 2's own types. 20 Hz where the table says nothing "
        "else.",
        "| topic | type | what |\n|---|---|---|\n" + "\n".join(rows),
        f"Fields of `{viewer.NUMBERS_TYPE}` after its header; NaN where nobody knows, 255 for a "
        "status that nobody has "
        "said yet.",
        "| field | type | meaning |\n|---|---|---|\n" + "\n".join(numbers),
    ]


def _message(kind: type[Any]) -> str:
    name, documented = schemas.TYPE_NAME[kind], dict(_field_docs(kind))
    text = f"## {kind.__name__}\n\n{_wrapped(_text(kind))} Type `{name}`."
    if name in schemas.DEFINITIONS:
        text += f"\n\n```\n{schemas.DEFINITIONS[name]}```"
    if kind in ON_THE_WIRE:
        return f"{text}\n\n{_wrapped(ON_THE_WIRE[kind])}"
    bounds = {field.name: field for field in schemas.FIELDS.get(kind, ())}
    rows = []
    for field_name, meaning in documented.items():
        bound = bounds.get(field_name)
        low, high = (bound.low, bound.high) if bound is not None else (-math.inf, math.inf)
        allowed = f"{_shown(low)} to {_shown(high)}" if math.isfinite(high) else ""
        if bound is not None and bound.enum is not None:
            allowed = ", ".join(f"{member.value} {member.name}" for member in bound.enum)
            meaning = meaning or " ".join(
                f"{member}: {said}" for member, said in _field_docs(bound.enum)
            )
        if meaning or allowed:
            rows.append(f"| `{field_name}` | {meaning} | {allowed} |")
    return text + "\n\n| field | meaning | allowed |\n|---|---|---|\n" + "\n".join(rows)


def _field_docs(kind: type[Any]) -> Iterator[tuple[str, str]]:
    """Name and docstring of each field of a dataclass, or of each member of an enumeration."""
    (definition,) = (
        node for node in ast.parse(inspect.getsource(kind)).body if isinstance(node, ast.ClassDef)
    )
    for statement, following in pairwise([*definition.body, None]):
        named = (
            statement.targets[0]
            if isinstance(statement, ast.Assign)
            else getattr(statement, "target", None)
        )
        if isinstance(named, ast.Name):
            text = ""
            if isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant):
                text = str(following.value.value)
            yield named.id, " ".join(text.split()).replace("|", "\\|")


def _text(kind: type[Any]) -> str:
    """A class's docstring without what it raises."""
    return inspect.cleandoc(kind.__doc__ or "").split("\n\nRaises:")[0].split("\n\nArgs:")[0]


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return "none" if not value else ", ".join(map(_shown, value))
    return f"{value:g}" if isinstance(value, float | int) else str(value)


def _wrapped(text: str) -> str:
    """Prose in lines of 100 characters; tables, titles and code as they are."""
    if text.lstrip().startswith(("|", "#", "```", "<!--")) or "\n|" in text or "```" in text:
        return text
    return "\n\n".join(
        textwrap.fill(paragraph, 100, break_long_words=False) for paragraph in text.split("\n\n")
    )


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for file, text in pages().items():
        (FOLDER / file).write_text(text, encoding="utf-8")
