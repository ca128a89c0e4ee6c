"""Dry friction is larger at standstill than in motion."""

from dataclasses import dataclass, field, replace

from saltus.arrays import Array, namespace
from saltus.effects.effect import Effect, Values, parameter
from saltus.effects.signals import Resistance

FADED = 30.0
"""Exponent beyond which the Stribeck curve counts as zero: exp(-30) is 1e-13, and float32 underflows later."""


@dataclass(frozen=True, kw_only=True)
class Stiction(Effect[Resistance], name="stiction", site="joint"):
    """Friction above the Coulomb level: `breakaway` at standstill, times exp(-(v / stribeck_velocity)^2) in motion."""

    # breakaway torque is 1.1 to 2 times the Coulomb level on drives of this class
    breakaway: Values = parameter(unit="Nm", null=0.0, low=0.0, high=20.0, sought=(0.0, 5.0), per_joint=True)
    # stick and slip are seen below 0.1 rad/s; without a breakaway torque it means nothing
    stribeck_velocity: Values = field(
        default=0.1, metadata={"unit": "rad/s", "low": 1e-3, "high": 10.0, "sought": (0.01, 2.0), "per_joint": True}
    )

    def apply(self, signal: Resistance, time_s: Array, state: None) -> tuple[Resistance, None]:
        """Adds to the friction."""
        del time_s, state
        xp = namespace(signal.friction)
        width, breakaway = (self.value(name, signal.friction) for name in ("stribeck_velocity", "breakaway"))
        share = xp.exp(-xp.clip((signal.velocity / width) ** 2, 0.0, FADED))
        return replace(signal, friction=signal.friction + breakaway * share), None
