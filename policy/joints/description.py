"""Everything that somebody needs to run a policy that commands joints,
as one value with a TOML form.

A policy that Saltus trains carries it in its ONNX file; for somebody else's it is written by hand.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from saltus.arrays import Floats
from saltus.config import TomlValue, check_between
from saltus.dialects import DIALECTS, Dialect
from saltus.errors import ConfigError, check_known
from saltus.grid import HeightGrid, load_grid
from saltus.robots.robot import JOINTS

ObservationPartName = Literal[
    "linear_velocity",
    "angular_velocity",
    "gravity",
    "command",
    "joint_position",
    "joint_velocity",
    "action",
    "heights",
]
LEAST_COMMAND = 0.1
"""Length of a commanded velocity, m/s and rad/s alike, below which a robot need not step;
legged_gym's."""
_VECTORS = ("linear_velocity", "angular_velocity", "gravity", "command")


@dataclass(frozen=True, kw_only=True)
class ObservationPart(TomlValue):
    """One part of a policy's observation; meanings and frames are those of `SensorArrays`."""

    name: ObservationPartName
    clip: float = math.inf
    """Cuts off each number beyond this, to either side; before the scale."""
    scale: float | tuple[float, ...] = 1.0
    """Multiplies the part: one number, or one for each entry."""

    def __post_init__(self) -> None:
        check_between(self, clip=(0.0, math.inf))


@dataclass(frozen=True, kw_only=True)
class PolicyDescription(TomlValue):
    """A policy's observation, its pose and gains.

    Joint arrays are in the order of `joints`, the policy's own.

    Raises:
        ConfigError: a name of a joint that no robot has or that comes twice, other than twelve
            numbers, or a number outside of its range.
    """

    robot: str
    """Name of the robot for which the policy was trained."""
    model: str = ""
    """ONNX file beside the TOML file; empty in a description that lies in one itself."""
    observation: tuple[ObservationPart, ...]
    """Parts of the vector, in order."""
    joints: tuple[str, ...] = JOINTS
    """Names of the joints in the policy's order; "_joint" at the end may be left out."""
    pose_rad: tuple[float, ...]
    """Joint angles at which `joint_position` and actions are zero."""
    action_scale_rad: float | tuple[float, ...]
    """A joint's target is its pose plus this times the action."""
    action_clip: float = 100.0
    """Actions are cut off beyond this, to either side; legged_gym's."""
    kp: float | tuple[float, ...]
    """[Nm/rad]."""
    kd: float | tuple[float, ...]
    """[Nm s/rad]."""
    rate_hz: float = 50.0
    grid: str = "scan"
    """Grid of the heights, by name or as a TOML file (`saltus.grid`)."""
    dialect: Dialect = field(default_factory=lambda: DIALECTS["isaaclab"])
    """Order, clip and scale of the heights that the policy reads (`saltus.dialects`)."""
    blind: bool = False
    """The policy is told level ground at its standing height in place of heights."""
    history: int = 1
    """Vectors that the policy is given at once."""
    history_of: Literal["vector", "part"] = "vector"
    """"vector": whole vectors one after the other. "part": those of each part, part after part,
    as IsaacLab's `history_length`. Before there are so many the first one stands in for them."""
    newest_first: bool = False
    """Order of a history; False: the oldest comes first."""
    command_low: tuple[float, float, float]
    command_high: tuple[float, float, float]
    """Commands beyond these are cut off: ahead, to the left [m/s], turning to the left [rad/s]."""

    def __post_init__(self) -> None:
        check_between(self, rate_hz=(1.0, 100.0), history=(1, 100), action_clip=(0.0, math.inf))
        places = [name.removesuffix("_joint") for name in self.joints]
        for name in places:
            check_known("joints: no joint", name, JOINTS)
        if len(set(places)) != len(JOINTS):
            raise ConfigError(f"joints: {len(set(places))} names, a robot has {len(JOINTS)}")
        for name in ("pose_rad", "action_scale_rad", "kp", "kd"):
            self._in_our_order(name)
        for part in self.observation:
            sizes = (1, self._size_of(part))
            if np.size(part.scale) not in sizes:
                raise ConfigError(
                    f"observation: {part.name} has {np.size(part.scale)} scales, it must have "
                    f"{sizes[0]} or {sizes[1]}"
                )

    @property
    def order(self) -> list[int]:
        """Place of each of the policy's joints among ours."""
        return [JOINTS.index(name.removesuffix("_joint")) for name in self.joints]

    @property
    def pose(self) -> Floats:
        """The pose in our order [rad], shape (12,)."""
        return self._in_our_order("pose_rad")

    @property
    def action_scale(self) -> Floats:
        """[rad] in our order, shape (12,)."""
        return self._in_our_order("action_scale_rad")

    @property
    def gains(self) -> tuple[Floats, Floats]:
        """Stiffness and damping in our order, shape (12,) each."""
        return self._in_our_order("kp"), self._in_our_order("kd")

    @property
    def sizes(self) -> list[int]:
        """Length of each part."""
        return [self._size_of(part) for part in self.observation]

    @property
    def size(self) -> int:
        """Length of what the network is given, history and all."""
        return self.history * sum(self.sizes)

    def height_grid(self) -> HeightGrid:
        """Points of the heights; `ConfigError` where there is no such grid."""
        return load_grid(self.grid)

    def obeyed(self, velocity: Sequence[float] | Floats) -> Floats:
        """A command within the range that the policy knows, shape (3,)."""
        return np.clip(np.asarray(velocity, np.float64), self.command_low, self.command_high)

    def _size_of(self, part: ObservationPart) -> int:
        if part.name in _VECTORS:
            return 3
        return self.height_grid().size if part.name == "heights" else len(JOINTS)

    def _in_our_order(self, name: str) -> Floats:
        value = np.asarray(getattr(self, name), np.float64)
        if value.shape not in ((), (len(JOINTS),)):
            raise ConfigError(f"{name}: {value.size} numbers, a robot has {len(JOINTS)} joints")
        ours = np.zeros(len(JOINTS))
        ours[self.order] = value
        return ours
