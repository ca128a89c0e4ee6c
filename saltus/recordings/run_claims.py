"""Claims of `meta.json` of a run log about the rig, their types:
which keys there must be, and what values they may have.

The simulator that a log is compared with is built from these claims, so each of them is checked
before anything else.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypedDict

from saltus.errors import RecordingError
from saltus.recordings.log_units import stated_units
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.robots.shipped import shipped_robots


class SegmentClaim(TypedDict):
    """A stretch of a run log and the motion in it, as the log claims it."""

    name: str
    t0: float
    """Beginning [s], on the log's clock, as the end."""
    t1: float
    condition: str


class CameraClaim(TypedDict, total=False):
    """Intrinsics [px], place [m] and turn [rad] on the base, and timing of a camera."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    position: list[float]
    roll: float
    pitch: float
    yaw: float
    rate: float
    """[Hz]."""
    latency: float
    """[s]."""
    range_max: float
    """[m]."""


class GroundClaim(TypedDict, total=False):
    """The ground that a robot stood on."""

    friction: float
    contact_time_constant: float
    """[s]."""


class ExcitationClaim(TypedDict, total=False):
    """The motions of a run log, in words and one by one, as the log claims them."""

    text: str
    segments: list[SegmentClaim]


class RigClaims(TypedDict, total=False):
    """All claims of a run log about robot, gains, ground and camera. Those of a log that was read
    are known to be sound.
    """

    schema: str
    joints: list[str]
    robot: str
    base: str
    """fixed or free."""
    control_dt: float
    """[s]."""
    kp: float | list[float]
    kd: float | list[float]
    payload_kg: float | None
    payload_position: list[float] | None
    motor_strength: float | None
    battery_v: float | None
    ground: GroundClaim
    camera: CameraClaim
    terrain: str | list[dict[str, object]]
    units: dict[str, object]
    segments: list[SegmentClaim]
    excitation: ExcitationClaim
    notes: str
    cut: str
    config: dict[str, Any]
    """Settings of the run that was exported."""


SCHEMA = "saltus-run/1"
SEGMENT_KEYS = ("name", "t0", "t1", "condition")
BASES = ("fixed", "free")
SECONDS = (-1e9, 1e9)

ClaimRange = tuple[float, float, str]
"""Smallest and largest value that is allowed, and the unit."""

GAINS: dict[str, ClaimRange] = {"kp": (0.0, 1e5, "Nm/rad"), "kd": (0.0, 1e4, "Nm s/rad")}
CONTROL_DT: ClaimRange = (1e-5, 1.0, "s")
OPTIONAL: dict[str, ClaimRange] = {
    "payload_kg": (0.0, 1e3, "kg"),
    "battery_v": (0.0, 1e3, "V"),
    "motor_strength": (0.1, 10.0, ""),
}
GROUND: dict[str, ClaimRange] = {
    "friction": (1e-3, 10.0, ""),
    "contact_time_constant": (1e-4, 1.0, "s"),
}
FOCAL: ClaimRange = (1e-2, 1e5, "px")
CENTRE: ClaimRange = (-1e5, 1e5, "px")
PIXELS: ClaimRange = (1, 1e4, "px")
CAMERA: dict[str, ClaimRange] = {
    "fx": FOCAL,
    "fy": FOCAL,
    "cx": CENTRE,
    "cy": CENTRE,
    "width": PIXELS,
    "height": PIXELS,
    "pitch": (-3.2, 3.2, "rad"),
}
CAMERA_OPTIONAL: dict[str, ClaimRange] = {
    "roll": (-3.2, 3.2, "rad"),
    "yaw": (-3.2, 3.2, "rad"),
    "rate": (0.0, 1e4, "Hz"),
    "latency": (0.0, 10.0, "s"),
    "range_max": (1e-2, 1e3, "m"),
}
PLACE: ClaimRange = (-1e4, 1e4, "m")
SIZE: ClaimRange = (1e-6, 1e5, "m")


def claim_of(robot: Robot) -> str:
    """Claim of meta.json about a robot: its name where Saltus ships it,
    else its model beside meta.json.

    A robot of one's own that has a shipped one's name is that one only with the same model,
    wherever its camera sits.
    """
    is_shipped = robot.name in shipped_robots() and robot.mjcf == load_robot(robot.name).mjcf
    return robot.name if is_shipped else f"{robot.name}.xml"


def check_claims(meta: Mapping[str, object]) -> None:
    """Checks all claims of a run log.

    Raises:
        RecordingError: a claim that is missing or cannot be; names the key, the value and what is
            allowed.
    """
    if meta.get("schema") != SCHEMA:
        raise RecordingError(f"schema {_shown(meta.get('schema'))}: this version reads '{SCHEMA}'")
    joints = meta.get("joints")
    if (
        not isinstance(joints, list)
        or not joints
        or not all(isinstance(name, str) for name in joints)
    ):
        raise _refused("joints", joints, "a list of names, in the order of the columns")
    if twice := [name for name in joints if joints.count(name) > 1]:
        raise _refused("joints", twice[0], "each name once")
    robot = meta.get("robot")
    if (
        not isinstance(robot, str) or Path(robot).name != robot
    ):  # nothing outside of the folder is read
        raise _refused(
            "robot",
            robot,
            f"{', '.join(shipped_robots())}, or the name of an MJCF file beside meta.json",
        )
    if meta.get("base") not in BASES:
        raise _refused("base", meta.get("base"), "'fixed' (held) or 'free'")
    for key, allowed in GAINS.items() if meta.keys() & GAINS.keys() else ():
        values = meta.get(key)
        each = values if isinstance(values, list) else [values]
        if len(each) not in (1, len(joints)) or not all(
            _is_within(value, allowed) for value in each
        ):
            raise _refused(
                key,
                values,
                f"{_range(allowed)}, one number or one for each of {len(joints)} joints",
            )
    _check(meta, "", {"control_dt": CONTROL_DT})
    _check_optional(meta, "", OPTIONAL)
    if meta.get("payload_position") is not None:
        _check_vector(meta, "payload_position", PLACE)
    _check_optional(_table(meta, "ground"), "ground.", GROUND)
    _check_camera(_table(meta, "camera"))
    _check_terrain(meta.get("terrain"))
    stated_units(meta)
    claimed_segments(meta)


def claimed_segments(meta: Mapping[str, object]) -> list[SegmentClaim]:
    """Segments that a log's meta.json names, beside `excitation` or within it.

    None if it names none.

    Raises:
        RecordingError: a segment without name, t0, t1 or condition, or that ends before it begins.
    """
    excitation = meta.get("excitation")
    named = (
        meta.get("segments", excitation.get("segments") if isinstance(excitation, dict) else None)
        or []
    )
    if not isinstance(named, list):
        raise _refused("segments", named, "a list")
    for segment in named:
        missing = [
            key for key in SEGMENT_KEYS if not isinstance(segment, dict) or key not in segment
        ]
        if missing:
            raise RecordingError(f"meta.json: a segment lacks '{missing[0]}': {_shown(segment)}")
        ends = [segment["t0"], segment["t1"]]
        if not all(_is_within(end, (*SECONDS, "s")) for end in ends) or ends[1] <= ends[0]:
            raise RecordingError(
                f"meta.json: segment {_shown(segment['name'])} must have numbers t0 < t1 [s]"
            )
    return named


def _check_camera(camera: Mapping[str, object]) -> None:
    if not camera:
        return
    _check(camera, "camera.", CAMERA)
    _check_optional(camera, "camera.", CAMERA_OPTIONAL)
    _check_vector(camera, "position", PLACE, "camera.")


def _check_terrain(terrain: object) -> None:
    if terrain is None or terrain == "flat":
        return
    if not isinstance(terrain, list) or not all(isinstance(box, dict) for box in terrain):
        raise _refused("terrain", terrain, "'flat' or a list of boxes")
    for number, box in enumerate(terrain):
        where = f"terrain[{number}]."
        _check_vector(box, "center", PLACE, where)
        _check_vector(box, "size", SIZE, where)
        for turn in ("pitch", "yaw"):
            if box.get(turn, 0) != 0:
                raise _refused(
                    where + turn, box[turn], "0: this version compares with level boxes only"
                )


def _check(table: Mapping[str, object], where: str, ranges: dict[str, ClaimRange]) -> None:
    for key, allowed in ranges.items():
        if not _is_within(table.get(key), allowed):
            raise _refused(where + key, table.get(key), _range(allowed))


def _check_optional(table: Mapping[str, object], where: str, ranges: dict[str, ClaimRange]) -> None:
    _check(
        table,
        where,
        {key: allowed for key, allowed in ranges.items() if table.get(key) is not None},
    )


def _check_vector(
    table: Mapping[str, object], key: str, allowed: ClaimRange, where: str = ""
) -> None:
    values = table.get(key)
    if (
        not isinstance(values, list)
        or len(values) != 3
        or not all(_is_within(value, allowed) for value in values)
    ):
        raise _refused(where + key, values, f"three numbers, {_range(allowed)}")


def _table(meta: Mapping[str, object], key: str) -> dict[str, object]:
    table = meta.get(key)
    if table is not None and not isinstance(table, dict):
        raise _refused(key, table, "an object with named values")
    return table or {}


def _is_within(value: Any, allowed: ClaimRange) -> bool:
    """False for what is not a finite number, too."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and allowed[0] <= value <= allowed[1]


def _range(allowed: ClaimRange) -> str:
    low, high, unit = allowed
    return f"{low:g} to {high:g} {unit}".rstrip()


def _refused(key: str, value: object, allowed: str) -> RecordingError:
    said = "is missing" if value is None else f"is {_shown(value)}"
    return RecordingError(f"meta.json: '{key}' {said}; allowed is {allowed}")


def _shown(value: object) -> str:
    """A value in a message, however long it is."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
