"""The current loop of a drive has a finite bandwidth."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from saltus.arrays import Constant
from saltus.effects.effect import Effect, Site, Values, parameter, period
from saltus.effects.signals import Drive
from saltus.go1 import PHYSICS_DT


@dataclass(frozen=True, kw_only=True)
class ActuatorLag(Effect[Drive]):
    """First-order lag: torque follows its target with `time_constant`, exactly discretised for a held target."""

    name: ClassVar[str] = "actuator_lag"
    site: ClassVar[Site] = "torque"

    # 2 to 8 ms on drives of this class
    time_constant: Values = parameter(unit="s", null=0.0, low=0.0, high=0.1, per_joint=True)
    dt_s: float = period(PHYSICS_DT)
    """Period of the torque."""

    @cached_property
    def _weights(self) -> tuple[Constant, Constant]:
        """Weights of the target and of the last torque."""
        time_constant = np.asarray(self.time_constant, dtype=float)
        # below a thousandth of a step the lag is none; it also keeps the division finite
        rest = np.exp(-self.dt_s / np.maximum(time_constant, 1e-3 * self.dt_s))  # exp(-1000) is 0
        return Constant(1.0 - rest), Constant(rest)

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> tuple[Any, ...]:
        """Empty: the first torque is taken to have been there for long."""
        del batch, rng
        return ()

    def apply(self, signal: Drive, time_s: float, state: tuple[Any, ...]) -> tuple[Drive, tuple[Any, ...]]:
        """Returns the lagged torque; the state is the last torque."""
        del time_s
        if not state:
            return signal, (signal.torque,)
        new, rest = (weight.like(signal.torque) for weight in self._weights)
        # (1 - r) x + r y, not x + r (y - x), is x to the bit where r is 0
        torque = new * signal.torque + rest * state[0]
        return replace(signal, torque=torque), (torque,)
