"""An encoder knows a finite number of angles."""

from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import namespace
from saltus.effects.effect import Effect, Values, like, parameter
from saltus.effects.signals import JointState


@dataclass(frozen=True, kw_only=True)
class EncoderQuantisation(Effect[JointState], name="encoder_quantisation", site="joint_state"):
    """The drive's angle is the nearest multiple of `step`; its velocity is not derived from it."""

    # 0.2 to 1.5 mrad on drives of this class
    step: Values = parameter(unit="rad", null=0.0, low=0.0, high=0.2, per_joint=True)

    def apply(self, signal: JointState, time_s: float, state: None) -> tuple[JointState, None]:
        """Rounds the angle where the step is not 0."""
        del time_s, state
        if np.all(np.asarray(self.step) == 0.0):
            return signal, None
        xp = namespace(signal.position)
        exact = np.asarray(self.step) == 0.0
        step = like(np.where(exact, 1.0, self.step), signal.position, xp)
        rounded = xp.round(signal.position / step) * step
        if np.any(exact):
            rounded = xp.where(xp.asarray(exact, device=signal.position.device), signal.position, rounded)
        return replace(signal, position=rounded), None
