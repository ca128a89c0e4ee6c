"""Dialects in which policies were trained to read a height scan:
order, sign, offset, clip and scale of its points.
"""

import math
from dataclasses import dataclass
from typing import Literal

from saltus.arrays import Points, namespace
from saltus.config import TomlValue, check_between
from saltus.errors import ConfigError, check_known
from saltus.grid import HeightGrid


@dataclass(frozen=True, kw_only=True)
class Dialect(TomlValue):
    """One policy's way to read heights: (how far the ground is below the base - offset),
    clipped, then scaled.

    Raises:
        ConfigError: a number that is none, or a negative clip.
    """

    outer_axis: Literal["x", "y"]
    """Coordinate that stays while the other one runs: with "y" the first points lie in a row from
    behind the robot to ahead of it, at its right."""
    offset_m: float = 0.0
    """Taken from the base's height above each point [m]: about the height at which the robot
    stands."""
    clip_m: float = math.inf
    """Greatest distance from the offset that the policy is told [m]; before the scale."""
    scale: float = 1.0

    def __post_init__(self) -> None:
        if self.outer_axis not in ("x", "y"):
            raise ConfigError(f"outer_axis = {self.outer_axis!r}: it must be 'x' or 'y'")
        check_between(self, offset_m=(-10.0, 10.0), clip_m=(0.0, math.inf), scale=(-1e3, 1e3))

    def observation(self, height: Points, grid: HeightGrid) -> Points:
        """Returns what the policy reads, numpy or torch, shape (..., grid.size).

        Args:
            height: Of the ground above the base [m], negative where it is below, in the order of
                `grid.points`, as all of Saltus tells it, shape (..., grid.size).
            grid: Points of the heights.

        Raises:
            ConfigError: there are not as many heights as points.
        """
        if height.shape[-1] != grid.size:
            raise ConfigError(
                f"there are {height.shape[-1]} heights, but the grid has {grid.size} points"
            )
        if self.outer_axis == "y":
            table = height.reshape(*height.shape[:-1], *grid.shape)
            height = namespace(height).matrix_transpose(table).reshape(height.shape)
        return (-height - self.offset_m).clip(-self.clip_m, self.clip_m) * self.scale


DIALECTS = {
    "isaaclab": Dialect(outer_axis="y", offset_m=0.5, clip_m=1.0),
    "legged_gym": Dialect(outer_axis="x", offset_m=0.5, clip_m=1.0, scale=5.0),
    "mjlab": Dialect(outer_axis="y", scale=0.2),
}
"""Dialects by name, as the projects' own velocity tasks have them: IsaacLab (`height_scan`,
`grid_pattern` in the order "xy", clip +-1; robot_lab, unitree_rl_lab and InstinctLab likewise),
legged_gym (`compute_observations`; unitree_rl_gym and walk-these-ways likewise; its noise of 0.1 m
is drawn after the scale), mjlab (`height_scan`, scale of 1 by the sensor's 5 m; unitree_rl_mjlab
likewise)."""


def dialect_of(name: str) -> Dialect:
    """The dialect of a name.

    Raises:
        ConfigError: no dialect is called so.
    """
    check_known("no dialect", name, DIALECTS)
    return DIALECTS[name]
