"""Types of what `meta.json` of a run log claims about the rig;
`run_claims` checks that it can be.
"""

from typing import Any, TypedDict


class SegmentClaim(TypedDict):
    """A motion of a run."""

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
    """The motions, in words and one by one."""

    text: str
    segments: list[SegmentClaim]


class RigClaims(TypedDict, total=False):
    """All claims. Those of a log that was read are known to be sound."""

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
