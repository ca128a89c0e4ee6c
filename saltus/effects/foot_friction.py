"""The ground is more or less slippery than is claimed."""

from dataclasses import dataclass
from typing import ClassVar

from saltus.effects.body import NOMINAL_FRICTION, BodyModel
from saltus.effects.effect import Effect, PerRobot, Site, parameter, scaled


@dataclass(frozen=True, kw_only=True)
class FootFriction(Effect[BodyModel]):
    """The coefficient of friction is `coefficient` where the model claims its nominal 0.8.

    It scales what is there: a trial that draws another ground keeps the ratio.
    """

    name: ClassVar[str] = "foot_friction"
    site: ClassVar[Site] = "model"

    # 0.4 to 1.0 on indoor floors; ice to rubber on dry asphalt
    coefficient: PerRobot = parameter(unit="", null=NOMINAL_FRICTION, low=0.05, high=2.0)

    def apply(self, signal: BodyModel, time_s: float, state: None) -> tuple[BodyModel, None]:
        """Scales the friction."""
        del time_s, state
        return scaled(signal, "friction", self.coefficient / NOMINAL_FRICTION), None
