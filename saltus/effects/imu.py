"""From the motion of the base to what its IMU reports: the effects of an IMU in their order."""

from dataclasses import dataclass
from typing import Any, ClassVar

from saltus.effects.order import Chain
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
class ImuChain(Chain):
    """The effects of an IMU."""

    order: ClassVar[tuple[str, ...]] = IMU_ORDER
    owner: ClassVar[str] = "an IMU"

    def step(self, reading: ImuReading, time_s: float, state: tuple[Any, ...]) -> tuple[ImuReading, tuple[Any, ...]]:
        """What the IMU reports of `reading`, once a physics step."""
        return self._passed(reading, time_s, state)
