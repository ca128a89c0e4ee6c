"""The short TOML beside an MJCF: what the model cannot say, or says otherwise than the robot is."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated

from saltus import config
from saltus.errors import ConfigError, check_known
from saltus.robots.robot import JOINTS, LEGS, LINKS, Gains

JointNumbers = tuple[float, ...] | None
PerJoint = Annotated[
    JointNumbers, "hip, thigh, calf of every leg, or twelve values in the order of JOINTS"
]


@dataclass(frozen=True, kw_only=True)
class RobotSupplement:
    """Fields of `saltus.robots.robot.Robot`, each of which may be left out."""

    name: str | None = None
    mjcf: str | None = None
    """Path of the model, from the folder of this file."""
    profile: str | None = None
    stand_pose: PerJoint = None
    stand_height: float | None = None
    joint_lower: PerJoint = None
    joint_upper: PerJoint = None
    torque_limit: PerJoint = None
    speed_limit: PerJoint = None
    reduction: PerJoint = None
    armature: PerJoint = None
    gains: dict[str, float] = field(default_factory=dict)
    trunk_size: JointNumbers = None
    trunk_center: JointNumbers = None
    inertia: JointNumbers = None
    swing_foot_z: JointNumbers = None
    neutral_foot: JointNumbers = None
    landing_reach: JointNumbers = None
    foot_force: JointNumbers = None
    camera_position: JointNumbers = None
    camera_pitch: float | None = None
    camera_roll: float | None = None
    camera_yaw: float | None = None

    def __post_init__(self) -> None:
        known = [f.name for f in fields(Gains)]
        for name in self.gains:
            check_known("unknown key", name, known, within="gains.")
        for f in fields(self):
            values = getattr(self, f.name)
            if f.type is PerJoint and values is not None:
                object.__setattr__(self, f.name, _of_all_legs(f.name, values))


def _of_all_legs(name: str, values: tuple[float, ...]) -> tuple[float, ...]:
    if len(values) not in (len(LINKS), len(JOINTS)):
        raise ConfigError(
            f"'{name}' has {len(values)} values: give 3 (hip, thigh, calf) or 12 "
            f"({', '.join(JOINTS)})"
        )
    return values if len(values) == len(JOINTS) else values * len(LEGS)


def load_supplement(path: Path | None) -> RobotSupplement:
    """Reads such a file; an empty one where there is none. `ConfigError` names the file."""
    return RobotSupplement() if path is None else config.load_config(RobotSupplement, path)
