"""The trunk turns more or less easily than is claimed."""

from dataclasses import dataclass
from typing import ClassVar

from saltus.effects.body import BodyModel
from saltus.effects.effect import Effect, PerRobot, Site, parameter, scaled


@dataclass(frozen=True, kw_only=True)
class BaseInertia(Effect[BodyModel]):
    """The trunk's moments of inertia about its centre of mass are `scale` times what is claimed."""

    name: ClassVar[str] = "base_inertia"
    site: ClassVar[Site] = "model"

    # +-20 % of domain randomisation, with room for cables and a battery that is left out
    scale: PerRobot = parameter(unit="", null=1.0, low=0.3, high=3.0)

    def apply(self, signal: BodyModel, time_s: float, state: None) -> tuple[BodyModel, None]:
        """Scales the inertia."""
        del time_s, state
        return scaled(signal, "inertia_scale", self.scale), None
