"""The robot carries more than is claimed."""

from dataclasses import dataclass
from typing import ClassVar

from saltus.effects.body import BodyModel
from saltus.effects.effect import Effect, PerRobot, Site, added, parameter


@dataclass(frozen=True, kw_only=True)
class PayloadMass(Effect[BodyModel]):
    """A box of `mass` on top of the trunk, beyond what is claimed; negative where the trunk is lighter."""

    name: ClassVar[str] = "payload_mass"
    site: ClassVar[Site] = "model"

    # camera and computer weigh 1 kg; robots of this class carry up to 5 kg
    mass: PerRobot = parameter(unit="kg", null=0.0, low=-3.0, high=10.0)

    def apply(self, signal: BodyModel, time_s: float, state: None) -> tuple[BodyModel, None]:
        """Adds the mass."""
        del time_s, state
        return added(signal, "payload_kg", self.mass), None
