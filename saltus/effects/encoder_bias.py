"""The zero of a drive's encoder is not where the model has it."""

from dataclasses import dataclass
from typing import ClassVar

from saltus.effects.effect import Effect, Site, Values, added, parameter
from saltus.effects.signals import JointState


@dataclass(frozen=True, kw_only=True)
class EncoderBias(Effect[JointState]):
    """The drive reads `bias` more than the joint's true angle; log and PD law both see the reading."""

    name: ClassVar[str] = "encoder_bias"
    site: ClassVar[Site] = "joint_state"

    # +-0.1 rad is what published identification methods allow
    bias: Values = parameter(unit="rad", null=0.0, low=-0.5, high=0.5, per_joint=True)

    def apply(self, signal: JointState, time_s: float, state: None) -> tuple[JointState, None]:
        """Shifts the angle."""
        del time_s, state
        return added(signal, "position", self.bias), None
