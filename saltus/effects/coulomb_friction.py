"""Dry friction resists motion with a torque that does not depend on speed."""

from dataclasses import dataclass
from typing import ClassVar

from saltus.effects.effect import Effect, Site, Values, added, parameter
from saltus.effects.signals import Resistance


@dataclass(frozen=True, kw_only=True)
class CoulombFriction(Effect[Resistance]):
    """A torque of at most `torque` against the motion; at standstill, whatever holds the joint still."""

    name: ClassVar[str] = "coulomb_friction"
    site: ClassVar[Site] = "joint"

    # 0.05 to 0.8 Nm at the joints of robots of this class
    torque: Values = parameter(unit="Nm", null=0.0, low=0.0, high=20.0, per_joint=True)

    def apply(self, signal: Resistance, time_s: float, state: None) -> tuple[Resistance, None]:
        """Adds to the friction."""
        del time_s, state
        return added(signal, "friction", self.torque), None
