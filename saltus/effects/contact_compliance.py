"""Feet and ground are softer than is claimed."""

from dataclasses import dataclass
from typing import ClassVar

from saltus.effects.body import NOMINAL_CONTACT_TIME_CONSTANT_S, BodyModel
from saltus.effects.effect import Effect, PerRobot, Site, parameter, scaled


@dataclass(frozen=True, kw_only=True)
class ContactCompliance(Effect[BodyModel]):
    """Contacts give way like a critically damped spring of `time_constant`.

    A foot that lands at 2 m/s sinks by 2 to 10 mm; that is 4 to 20 ms.
    """

    name: ClassVar[str] = "contact_compliance"
    site: ClassVar[Site] = "model"

    # the engine takes no less than two time steps of 2 ms
    time_constant: PerRobot = parameter(unit="s", null=NOMINAL_CONTACT_TIME_CONSTANT_S, low=0.004, high=0.1)

    def apply(self, signal: BodyModel, time_s: float, state: None) -> tuple[BodyModel, None]:
        """Scales the time constant of the contacts."""
        del time_s, state
        return scaled(signal, "contact_time_constant", self.time_constant / NOMINAL_CONTACT_TIME_CONSTANT_S), None
