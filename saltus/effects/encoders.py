"""Effects between the motion of a joint and what its drive knows of it:
bias, scale, quantisation, filter.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from saltus.arrays import Array, Constant, namespace
from saltus.constants import PHYSICS_DT
from saltus.effects.effect import Effect, Values, parameter, period
from saltus.effects.signals import EncoderReading


@dataclass(frozen=True, kw_only=True)
class EncoderBias(Effect[EncoderReading], name="encoder_bias", site="joint_state"):
    """The drive reads `bias` more than the joint's true angle.

    Log and PD law both see the reading.
    """

    # +-0.1 rad is what published identification methods allow
    bias: Values = parameter(
        unit="rad",
        null=0.0,
        low=-0.5,
        high=0.5,
        sought=(-0.3, 0.3),
        per_joint=True,
        adds_to="position",
    )


@dataclass(frozen=True, kw_only=True)
class VelocityScale(Effect[EncoderReading], name="velocity_scale", site="joint_state"):
    """The drive reads `scale` times the joint's true velocity.

    Log and PD law both see the reading.
    """

    # 1.11 to 1.16 on a Go2
    scale: Values = parameter(
        unit="", null=1.0, low=0.2, high=5.0, sought=(0.3, 4.0), per_joint=True, scales="velocity"
    )


@dataclass(frozen=True, kw_only=True)
class EncoderQuantisation(Effect[EncoderReading], name="encoder_quantisation", site="joint_state"):
    """The drive's angle is the nearest multiple of `step`; its velocity is not derived from it."""

    # 0.2 to 1.5 mrad on drives of this class
    step: Values = parameter(
        unit="rad", null=0.0, low=0.0, high=0.2, sought=(2e-4, 0.1), per_joint=True
    )

    @cached_property
    def _steps(self) -> tuple[Constant, Constant]:
        """The steps, and those of them that are 0 as 1, to divide by."""
        return Constant(self.step), Constant(np.where(np.equal(self.step, 0.0), 1.0, self.step))

    def apply(
        self, signal: EncoderReading, time_s: Array, state: None
    ) -> tuple[EncoderReading, None]:
        """Rounds the angle where the step is not 0."""
        exact = signal.position
        step, divisor = (constant.like(exact) for constant in self._steps)
        xp = namespace(exact)
        return replace(
            signal, position=xp.where(step > 0.0, xp.round(exact / divisor) * divisor, exact)
        ), None


SHORTEST = 1e-3
"""Shortest filter, in parts of a period: a shorter one is none, and the weights stay finite."""
VelocityFilterState = tuple[Array, Array]
"""The last velocity and the last filtered one."""


@dataclass(frozen=True, kw_only=True)
class VelocityFilter(Effect[EncoderReading], name="velocity_filter", site="joint_state"):
    """First-order low-pass of the velocity with `time_constant`,
    exact where the velocity is linear between samples.
    """

    # drives of this class average over a few milliseconds
    time_constant: Values = parameter(
        unit="s", null=0.0, low=0.0, high=0.1, sought=(0.0, 0.05), per_joint=True
    )
    dt_s: float = period(PHYSICS_DT)
    """Period of the velocity."""

    @cached_property
    def _weights(self) -> tuple[Constant, Constant, Constant]:
        """Weights of the newest velocity, of the one before, and of the last filtered one."""
        return tuple(Constant(w) for w in low_pass_weights(self.time_constant, self.dt_s))  # type: ignore[return-value]

    def first(self, signal: EncoderReading) -> VelocityFilterState:
        """The first velocity has been there for long."""
        return signal.velocity, signal.velocity

    def apply(
        self, signal: EncoderReading, time_s: Array, state: VelocityFilterState | None
    ) -> tuple[EncoderReading, VelocityFilterState]:
        """Filters the velocity."""
        newest = signal.velocity
        before, filtered = state or (newest, newest)
        new, old, kept = (weight.like(newest) for weight in self._weights)
        velocity = new * newest + old * before + kept * filtered
        return replace(signal, velocity=velocity), (newest, velocity)


def low_pass_weights(
    time_constant: Values, dt_s: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights of newest input, the one before and last output, for an input linear in between.

    Sum 1.
    """
    steps = np.asarray(time_constant, dtype=float) / dt_s
    kept = np.exp(-1.0 / np.maximum(steps, SHORTEST))
    new = 1.0 - steps * (1.0 - kept)
    return new, 1.0 - new - kept, kept
