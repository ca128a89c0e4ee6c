"""A motor that runs fast has little voltage left for torque."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from saltus.arrays import Array, Constant, namespace
from saltus.effects.effect import Effect, Values, from_robot, parameter
from saltus.effects.signals import Drive
from saltus.errors import ConfigError
from saltus.robots.robot import JOINTS

# Torque [Nm] and speed [rad/s] that no joint reaches, for joints without limit: infinity times a share of zero is not
# a number. float32 holds it.
UNLIMITED = 1e9


@dataclass(frozen=True, kw_only=True)
class TorqueSpeedLimit(Effect[Drive], name="torque_speed_limit", site="torque"):
    """Along the motion, torque is at most the torque limit, less beyond `corner`, none from `no_load` on.

    Against the motion the full torque limit holds. The original's limit is the line with corner 0 and no-load speeds
    30, 30, 20 rad/s.
    """

    corner: Values = parameter(unit="rad/s", null=math.inf, low=0.0, high=200.0, sought=(0.0, 30.0), per_joint=True)
    no_load: Values = parameter(unit="rad/s", null=math.inf, low=0.3, high=200.0, per_joint=True)
    # torque up to the corner; by default the robot's torque limit
    stall: Values | None = from_robot("torque_limit", unit="Nm", high=1e5)

    def __post_init__(self) -> None:
        super().__post_init__()
        corner, no_load = np.asarray(self.corner), np.asarray(self.no_load)
        if not np.all((corner < no_load) | np.isinf(no_load)):
            raise ConfigError(f"{self.name}: corner = {self.corner!r} must be below no_load = {self.no_load!r} rad/s")

    @cached_property
    def _bounds(self) -> tuple[Constant, Constant, Constant]:
        """Stall torque, no-load speed, and share of the stall torque lost per speed beyond the corner."""
        stall = self.of_robot("stall")
        limited = np.isfinite(self.no_load) & np.ones(len(JOINTS), dtype=bool)
        no_load = np.where(limited, self.no_load, UNLIMITED)
        span = no_load - np.where(limited, self.corner, 0.0)
        return Constant(np.where(limited, stall, UNLIMITED)), Constant(no_load), Constant(1.0 / span)

    def apply(self, signal: Drive, time_s: Array, state: None) -> tuple[Drive, None]:
        """Clips the torque."""
        del time_s, state
        torque, velocity = signal.torque, signal.velocity
        xp = namespace(torque)
        stall, no_load, slope = (constant.like(torque) for constant in self._bounds)
        along = stall * xp.clip((no_load - xp.abs(velocity)) * slope, 0.0, 1.0)
        upper = xp.where(velocity > 0, along, stall)
        lower = xp.where(velocity < 0, along, stall)
        return replace(signal, torque=xp.minimum(xp.maximum(torque, -lower), upper)), None
