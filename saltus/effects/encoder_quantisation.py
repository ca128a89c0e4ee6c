"""An encoder knows a finite number of angles."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from saltus.arrays import Array, Constant, namespace
from saltus.effects.effect import Effect, Values, parameter
from saltus.effects.signals import JointState


@dataclass(frozen=True, kw_only=True)
class EncoderQuantisation(Effect[JointState], name="encoder_quantisation", site="joint_state"):
    """The drive's angle is the nearest multiple of `step`; its velocity is not derived from it."""

    # 0.2 to 1.5 mrad on drives of this class
    step: Values = parameter(unit="rad", null=0.0, low=0.0, high=0.2, sought=(2e-4, 0.1), per_joint=True)

    @cached_property
    def _steps(self) -> tuple[Constant, Constant]:
        """The steps, and those of them that are 0 as 1, to divide by."""
        return Constant(self.step), Constant(np.where(np.equal(self.step, 0.0), 1.0, self.step))

    def apply(self, signal: JointState, time_s: Array, state: None) -> tuple[JointState, None]:
        """Rounds the angle where the step is not 0."""
        del time_s, state
        exact = signal.position
        step, divisor = (constant.like(exact) for constant in self._steps)
        xp = namespace(exact)
        return replace(signal, position=xp.where(step > 0.0, xp.round(exact / divisor) * divisor, exact)), None
