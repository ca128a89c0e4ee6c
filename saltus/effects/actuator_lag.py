"""The current loop of a drive has a finite bandwidth."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from saltus.arrays import Array, Constant
from saltus.constants import PHYSICS_DT
from saltus.effects.effect import Effect, Values, parameter, period
from saltus.effects.signals import Drive


@dataclass(frozen=True, kw_only=True)
class ActuatorLag(Effect[Drive], name="actuator_lag", site="torque"):
    """First-order lag: torque follows its target with `time_constant`.

    Targets are held over a period; what is delivered is the mean over it, so that the impulse is exact.
    """

    # 2 to 8 ms on drives of this class
    time_constant: Values = parameter(unit="s", null=0.0, low=0.0, high=0.1, sought=(0.0, 0.05), per_joint=True)
    dt_s: float = period(PHYSICS_DT)
    """Period of the torque."""

    @cached_property
    def _weights(self) -> tuple[Constant, Constant]:
        """Weights of the lagged torque at the start of a period: in the mean over it, and in the torque at its end."""
        return tuple(Constant(weight) for weight in lag_weights(self.time_constant, self.dt_s))  # type: ignore[return-value]

    def first(self, signal: Drive) -> Array:
        """The lagged torque at the end of the period before, shape (..., 12)."""
        return signal.torque

    def apply(self, signal: Drive, time_s: Array, state: Array) -> tuple[Drive, Array]:
        """Returns the mean of the lagged torque; the state is that at the end of the period."""
        del time_s
        before = self.first(signal) if state is None else state
        in_mean, at_end = (weight.like(signal.torque) for weight in self._weights)
        # (1 - r) x + r y, not x + r (y - x), is x to the bit where r is 0
        mean = (1.0 - in_mean) * signal.torque + in_mean * before
        return replace(signal, torque=mean), (1.0 - at_end) * signal.torque + at_end * before


def lag_weights(time_constant: Values, dt_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Weight of the lagged torque at the start of a period of `dt_s`: in the mean over the period, and at its end."""
    periods = np.asarray(time_constant, dtype=float) / dt_s
    # below a thousandth of a period the lag is none; it also keeps the division finite
    at_end = np.exp(-1.0 / np.maximum(periods, 1e-3))  # exp(-1000) is 0
    return periods * (1.0 - at_end), at_end
