"""The rotor of a motor, seen through its gear, is heavier than its data sheet says."""

from dataclasses import dataclass
from typing import ClassVar

from saltus.effects.effect import Effect, Site, Values, added, parameter
from saltus.effects.signals import Resistance


@dataclass(frozen=True, kw_only=True)
class Armature(Effect[Resistance]):
    """Inertia `added` at the joint, that turns with the joint alone."""

    name: ClassVar[str] = "armature"
    site: ClassVar[Site] = "joint"

    # the rotors of a Go1 make 0.0020 at hip and thigh and 0.0045 at the calf (unitree_ros)
    added: Values = parameter(unit="kg m2", null=0.0, low=-0.0015, high=0.5, per_joint=True)

    def apply(self, signal: Resistance, time_s: float, state: None) -> tuple[Resistance, None]:
        """Adds to the inertia."""
        del time_s, state
        return added(signal, "armature", self.added), None
