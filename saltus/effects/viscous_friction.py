"""Oil and bearings resist motion in proportion to its speed."""

from dataclasses import dataclass
from typing import ClassVar

from saltus.effects.effect import Effect, Site, Values, added, parameter
from saltus.effects.signals import Resistance


@dataclass(frozen=True, kw_only=True)
class ViscousFriction(Effect[Resistance]):
    """A torque of `coefficient` times the joint's velocity against the motion."""

    name: ClassVar[str] = "viscous_friction"
    site: ClassVar[Site] = "joint"

    # 0.1 to 0.4 Nm s/rad on drives of this class
    coefficient: Values = parameter(unit="Nm s/rad", null=0.0, low=0.0, high=10.0, per_joint=True)

    def apply(self, signal: Resistance, time_s: float, state: None) -> tuple[Resistance, None]:
        """Adds to the damping."""
        del time_s, state
        return added(signal, "damping", self.coefficient), None
