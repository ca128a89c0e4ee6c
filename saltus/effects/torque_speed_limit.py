"""A motor that runs fast has little voltage left for torque."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import array_api_compat
import numpy as np

from saltus.effects.effect import Effect, Site, Values, like, parameter
from saltus.effects.signals import Drive
from saltus.errors import ConfigError
from saltus.go1 import TORQUE_LIMIT


@dataclass(frozen=True, kw_only=True)
class TorqueSpeedLimit(Effect[Drive]):
    """Along the motion, torque is at most the torque limit, less beyond `corner`, none from `no_load` on.

    Against the motion the full torque limit holds. The original's limit is the line with corner 0 and no-load speeds
    30, 30, 20 rad/s.
    """

    name: ClassVar[str] = "torque_speed_limit"
    site: ClassVar[Site] = "torque"

    corner: Values = parameter(unit="rad/s", null=math.inf, low=0.0, high=200.0)
    no_load: Values = parameter(unit="rad/s", null=math.inf, low=1.0, high=200.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        corner, no_load = np.asarray(self.corner), np.asarray(self.no_load)
        if not np.all((corner < no_load) | np.isinf(no_load)):
            raise ConfigError(f"{self.name}: corner = {self.corner!r} must be below no_load = {self.no_load!r} rad/s")

    def apply(self, signal: Drive, time_s: float, state: None) -> tuple[Drive, None]:
        """Clips the torque."""
        del time_s, state
        xp = array_api_compat.array_namespace(signal.torque)
        finite = np.isfinite(self.no_load)
        no_load = np.where(finite, self.no_load, 1.0)
        span = no_load - np.where(finite, self.corner, 0.0)
        limit = np.where(finite, TORQUE_LIMIT, math.inf)
        share = (like(no_load, signal.torque, xp) - xp.abs(signal.velocity)) / like(span, signal.torque, xp)
        # a limit that is infinite must not meet a share of zero
        along = like(np.where(finite, TORQUE_LIMIT, 1.0), signal.torque, xp) * xp.clip(share, 0.0, 1.0)
        along = xp.where(like(finite, signal.torque, xp) > 0, along, math.inf)
        limit_like = like(limit, signal.torque, xp)
        upper = xp.where(signal.velocity > 0, along, limit_like)
        lower = xp.where(signal.velocity < 0, along, limit_like)
        return replace(signal, torque=xp.minimum(xp.maximum(signal.torque, -lower), upper)), None
