"""A motor is stronger or weaker than its data sheet says."""

from dataclasses import dataclass
from typing import ClassVar

from saltus.effects.effect import Effect, Site, Values, parameter, scaled
from saltus.effects.signals import Drive


@dataclass(frozen=True, kw_only=True)
class TorqueGain(Effect[Drive]):
    """Delivered torque is `gain` times what it would be: torque constant, gear efficiency."""

    name: ClassVar[str] = "torque_gain"
    site: ClassVar[Site] = "torque"

    # +-10 % is the usual range of domain randomisation
    gain: Values = parameter(unit="", null=1.0, low=0.0, high=2.0, per_joint=True)

    def apply(self, signal: Drive, time_s: float, state: None) -> tuple[Drive, None]:
        """Scales the torque."""
        del time_s, state
        return scaled(signal, "torque", self.gain), None
