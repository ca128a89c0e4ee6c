"""A robot as one value, with a TOML form and a fingerprint.

Legs come in the order FR, FL, RR, RL, joints of a leg as hip (abduction), thigh, calf. The base
frame has x forward and z up. Joint angles are positive about x (hip) and y (thigh, calf), so that a
positive thigh swings the foot backwards; where a robot's own drives count the other way,
`joint_sign` says so.
"""

import hashlib
import math
import re
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from saltus.arrays import Floats
from saltus.config import TomlValue
from saltus.errors import ConfigError

LEGS = ("FR", "FL", "RR", "RL")
LINKS = ("hip", "thigh", "calf")
SIDE = (-1.0, 1.0, -1.0, 1.0)
"""+1 for left legs, -1 for right legs."""
JOINTS = tuple(f"{leg}_{link}" for leg in LEGS for link in LINKS)

FINGERPRINT_DIGITS = 9  # of each number: its last digits may differ from one processor to the next
_NUMBER = re.compile(r"-?\d+(\.\d+)?([eE][-+]?\d+)?")


def _array(*shape: int) -> Any:
    """Declares a field that is an array."""
    return field(metadata={"shape": shape})


@dataclass(frozen=True, kw_only=True)
class Gains:
    """Gains of the leg controller, the same for all joints: kp [Nm/rad], kd [Nm s/rad]."""

    stand_kp: float
    stand_kd: float
    landing_kp: float
    landing_kd: float
    swing_kp: float
    swing_kd: float
    stance_kd: float
    """Gain of the velocity feedback of legs that stand."""
    damp_kd: float
    """Damping of a robot that is not upright."""
    brake_kd: float = 0.0
    """Damping of joints that run or jump at their rated speed; from 0.8 of it on it grows from
    nothing."""
    landing_bend: float = 0.0
    """Least angle by which knees of legs in the air are bent while the robot is fast [rad]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Robot(TomlValue):
    """A quadruped with legs of three hinges: abduction about x, then thigh and calf about y.

    Robots are equal when their fingerprints are. Arrays cannot be written.

    Raises:
        ConfigError: an array of another shape, a value that is no number, or a length or mass that
            is not positive.
    """

    name: str

    # Geometry
    hip_anchor: Floats = _array(4, 3)
    """Abduction axis of each leg, at the thigh's place along it, base frame [m], shape (4, 3)."""
    abduction_offset: Floats = _array(4)
    """Offset of each foot from its abduction axis, to the left [m], shape (4,)."""
    thigh_length: float
    """From the thigh's axis to the knee's [m]."""
    calf_length: float
    """From the knee's axis to the centre of the foot [m]."""
    thigh_zero: float = 0.0
    """Angle of the line from thigh axis to knee, from straight down, where all joints are zero
    [rad]."""
    shin_zero: float = 0.0
    """Angle of the line from knee to foot, from straight down, at zero joints [rad]."""
    foot_radius: float
    """[m]; feet are spheres."""
    trunk_size: Floats = _array(3)
    """Full edge lengths of the trunk's box [m], shape (3,)."""
    trunk_center: Floats = _array(3)
    """Centre of that box, base frame [m], shape (3,)."""

    # Masses
    trunk_mass: float
    """With everything that is fixed to it [kg]."""
    link_mass: Floats = _array(12)
    """Mass of hip, thigh and calf of each leg [kg], shape (12,)."""
    inertia: Floats = _array(3)
    """Inertia of the whole robot about x, y, z of the base, as the controller takes it [kg m^2],
    shape (3,)."""

    # Drives
    armature: Floats = _array(12)
    """Inertia of the rotor, seen at the joint [kg m^2], shape (12,)."""
    reduction: Floats = _array(12)
    """From motor to joint, shape (12,)."""
    joint_sign: Floats = _array(12)
    """+1, or -1 where the robot's own model counts an angle the other way, shape (12,)."""
    joint_lower: Floats = _array(12)
    joint_upper: Floats = _array(12)
    """Limits of the joints [rad], infinite where there is none, shape (12,)."""
    torque_limit: Floats = _array(12)
    """[Nm], infinite where it is not known, shape (12,)."""
    speed_limit: Floats = _array(12)
    """[rad/s], infinite where it is not known, shape (12,)."""

    # Standing and stepping
    stand_pose: Floats = _array(12)
    """Joint angles in which the robot stands [rad], shape (12,)."""
    stand_height: float
    """Height of the base above the ground there [m]."""
    gains: Gains
    swing_foot_z: Floats = _array(2)
    """Lowest and highest place of a swinging foot in the base frame [m], shape (2,): the controller
    keeps within it, and a policy is trained with it."""
    neutral_foot: Floats = _array(2)
    """Where a foot is below the body, ahead of the base (rear: behind) and sideways [m], shape
    (2,)."""
    landing_reach: Floats = _array(2)
    """How far a foot may land from there, in x and y [m], shape (2,)."""
    foot_force: Floats = _array(2)
    """Smallest and largest vertical force that is planned on a foot that stands [N], shape (2,)."""

    # Camera
    camera_position: Floats = _array(3)
    """Optical centre in the base frame [m], shape (3,)."""
    camera_pitch: float
    """Nose down positive [rad]."""
    camera_roll: float = 0.0
    """About the optical axis, right side down positive [rad]."""
    camera_yaw: float = 0.0
    """To the left positive [rad]; the camera is turned by yaw, then pitch, then roll."""

    profile: str
    """Name of the profile that it has as shipped."""
    mjcf: str = field(repr=False)
    """Its model: a trunk of one box and links of the names and the order of this module. What
    MuJoCo simulates is made from it (`saltus.sim.robot_model`)."""

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if "shape" in f.metadata:
                object.__setattr__(self, f.name, _checked_array(f.name, value, f.metadata["shape"]))
            elif f.type is float and not math.isfinite(value):
                raise ConfigError(f"robot.{f.name} = {value}: it must be a number")
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", self.name):
            raise ConfigError(f"'{self.name}' cannot name a robot: use letters, digits, _ and -")
        for name in ("thigh_length", "calf_length", "foot_radius", "trunk_mass", "stand_height"):
            if getattr(self, name) <= 0.0:
                raise ConfigError(f"robot.{name} = {getattr(self, name):g}: it must be more than 0")
        if not (self.joint_lower < self.joint_upper).all():
            raise ConfigError("robot.joint_lower: it must be below joint_upper")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Robot) and self.fingerprint == other.fingerprint

    def __hash__(self) -> int:
        return hash(self.fingerprint)

    @cached_property
    def side(self) -> Floats:
        """+1 for left legs, -1 for right legs, shape (4,)."""
        return np.array(SIDE)

    @cached_property
    def mass(self) -> float:
        """Mass of the whole robot [kg]."""
        legs = self.link_mass.reshape(4, 3)
        of_leg = legs[:, 0] + legs[:, 1] + legs[:, 2]
        return float(self.trunk_mass + ((of_leg[0] + of_leg[1]) + (of_leg[2] + of_leg[3])))

    @cached_property
    def leg_length(self) -> float:
        """Thigh and calf [m]."""
        return self.thigh_length + self.calf_length

    @cached_property
    def fingerprint(self) -> str:
        """16 hexadecimal digits that are the same for the same robot on every computer."""
        content = _NUMBER.sub(_shortened, self.to_toml())
        return hashlib.sha256(content.encode()).hexdigest()[:16]


def _checked_array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Floats:
    """`value` as an array that cannot be written."""
    array = np.array(value, dtype=np.float64)
    if array.shape != shape or np.isnan(array).any():
        raise ConfigError(
            f"robot.{name} = {value!r}: it must hold {' x '.join(map(str, shape))} numbers"
        )
    array.flags.writeable = False
    return array


def _shortened(number: re.Match[str]) -> str:
    return f"{float(number.group()) + 0.0:.{FINGERPRINT_DIGITS}g}"
