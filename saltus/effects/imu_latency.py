"""The IMU reports late."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from saltus.arrays import namespace
from saltus.constants import PHYSICS_DT
from saltus.effects.delay_line import History, delayed
from saltus.effects.effect import Effect, PerRobot, parameter, period
from saltus.effects.imu import ImuReading


@dataclass(frozen=True, kw_only=True)
class ImuLatency(Effect[ImuReading], name="imu_latency", site="imu"):
    """Orientation, rates and acceleration are all `delay` old."""

    # filters and buses of this class: 2 to 15 ms
    delay: PerRobot = parameter(unit="s", null=0.0, low=0.0, high=0.1)
    dt_s: float = period(PHYSICS_DT)
    """Period of the samples."""

    def apply(self, signal: ImuReading, time_s: float, state: History) -> tuple[ImuReading, History]:
        """Reports the sample of `delay` ago, in between two samples their mean."""
        del time_s
        now = (signal.quaternion_base_in_world, signal.angular_velocity_base, signal.acceleration_base)
        delay = self.delay if isinstance(self.delay, float | int) else np.asarray(self.delay)[..., None]
        (quaternion, rate, acceleration), line = delayed(now, state, delay, self.dt_s)
        if np.any(np.not_equal(self.delay, 0.0)):
            quaternion = quaternion / _norm(quaternion)
        reading = ImuReading(
            quaternion_base_in_world=quaternion, angular_velocity_base=rate, acceleration_base=acceleration
        )
        return reading, line


def _norm(quaternion: Any) -> Any:
    return namespace(quaternion).linalg.vector_norm(quaternion, axis=-1, keepdims=True)
