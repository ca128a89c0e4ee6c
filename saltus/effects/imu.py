"""From the motion of the base to what its IMU reports: the effects of an IMU in their order."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from saltus.effects.effect import Effect
from saltus.effects.order import ordered
from saltus.wire.messages import Floats

IMU_ORDER = ("imu_bias", "imu_latency")
"""A sensor is wrong first, and then late."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ImuReading:
    """One sample of an IMU. Site "imu"."""

    quaternion_base_in_world: Floats
    """(w, x, y, z), shape (..., 4)."""
    angular_velocity_base: Floats
    """[rad/s], shape (..., 3)."""
    acceleration_base: Floats
    """Specific force [m/s^2], shape (..., 3)."""


@dataclass(frozen=True)
class ImuChain:
    """The effects of an IMU, whatever the order in which they are given; null ones are left out.

    Raises:
        ConfigError: an effect that is given twice, or that is not one of an IMU.
    """

    effects: tuple[Effect[Any], ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "effects", ordered(self.effects, IMU_ORDER, "an IMU"))

    def init(self, batch: tuple[int, ...], rng: np.random.Generator) -> tuple[Any, ...]:
        """State before the first sample, for `batch` robots."""
        return tuple(effect.init(batch, rng) for effect in self.effects)

    def step(self, reading: ImuReading, time_s: float, state: tuple[Any, ...]) -> tuple[ImuReading, tuple[Any, ...]]:
        """What the IMU reports of `reading`, once a physics step."""
        states = []
        for effect, memory in zip(self.effects, state, strict=True):
            reading, memory = effect.apply(reading, time_s, memory)
            states.append(memory)
        return reading, tuple(states)
