"""Where a joint ends."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from saltus.arrays import Array, namespace
from saltus.constants import PHYSICS_DT
from saltus.effects.effect import Effect, Values, parameter, period
from saltus.effects.signals import Drive
from saltus.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class EndStop(Effect[Drive], name="end_stop", site="torque"):
    """A joint's stops are soft and begin early: beyond `upper` or below `lower` a spring of `stiffness` pushes it back.

    The limits of the robot's model, which are hard, stay.
    """

    # the calves of a Go2 lean on a stop that begins 0.09 rad before the model's limit
    upper: Values = parameter(unit="rad", null=math.inf, low=-7.0, high=7.0, per_joint=True)
    lower: Values = parameter(unit="rad", null=-math.inf, low=-7.0, high=7.0, per_joint=True)
    # that of a Go2's calves; without a stop it means nothing
    stiffness: Values = field(
        default=340.0,
        metadata={"unit": "Nm/rad", "low": 1.0, "high": 3000.0, "sought": (0.0, 3000.0), "per_joint": True},
    )
    dt_s: float = period(PHYSICS_DT)
    """Period of the torque."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.all(np.asarray(self.lower) < np.asarray(self.upper)):
            raise ConfigError(f"{self.name}: lower = {self.lower!r} must be below upper = {self.upper!r} rad")

    def apply(self, signal: Drive, time_s: Array, state: None) -> tuple[Drive, None]:
        """Adds the push at the angle halfway through the coming period: an older one would feed the joint energy."""
        del time_s, state
        xp = namespace(signal.torque)
        upper, lower, stiffness = (self.value(name, signal.torque) for name in ("upper", "lower", "stiffness"))
        halfway = signal.position + 0.5 * self.dt_s * signal.velocity
        beyond = xp.clip(halfway - upper, 0.0, math.inf) - xp.clip(lower - halfway, 0.0, math.inf)
        return replace(signal, torque=signal.torque - stiffness * beyond), None
