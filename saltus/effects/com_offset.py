"""The trunk's centre of mass is not where it is claimed to be."""

from dataclasses import dataclass, replace
from typing import ClassVar

from saltus.arrays import namespace
from saltus.effects.body import BodyModel
from saltus.effects.effect import Effect, PerRobot, Site, like, parameter


@dataclass(frozen=True, kw_only=True)
class ComOffset(Effect[BodyModel]):
    """The centre of mass of the trunk alone is off by (`x`, `y`, `z`) in the base frame."""

    name: ClassVar[str] = "com_offset"
    site: ClassVar[Site] = "model"

    # +-2 to 5 cm of domain randomisation; the trunk's half length is 0.19 m
    x: PerRobot = parameter(unit="m", null=0.0, low=-0.19, high=0.19)
    y: PerRobot = parameter(unit="m", null=0.0, low=-0.1, high=0.1)
    z: PerRobot = parameter(unit="m", null=0.0, low=-0.1, high=0.1)

    def apply(self, signal: BodyModel, time_s: float, state: None) -> tuple[BodyModel, None]:
        """Moves the centre of mass."""
        del time_s, state
        xp, shift = namespace(signal.com_shift), signal.com_shift
        axes = tuple(shift[..., i] + like(v, shift, xp) for i, v in enumerate((self.x, self.y, self.z)))
        return replace(signal, com_shift=xp.stack(axes, -1)), None
