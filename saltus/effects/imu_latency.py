"""The IMU reports late."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from saltus.arrays import Array, namespace
from saltus.constants import PHYSICS_DT
from saltus.effects.delay_line import DelayLine
from saltus.effects.effect import Effect, PerRobot, parameter, period
from saltus.effects.imu import ImuReading


@dataclass(frozen=True, kw_only=True)
class ImuLatency(Effect[ImuReading], name="imu_latency", site="imu"):
    """Orientation, rates and acceleration are all `delay` old."""

    # filters and buses of this class: 2 to 15 ms
    delay: PerRobot = parameter(unit="s", null=0.0, low=0.0, high=0.1)
    dt_s: float = period(PHYSICS_DT)
    """Period of the samples."""

    @cached_property
    def _is_late(self) -> bool:
        return not self.is_null()

    @cached_property
    def _line(self) -> DelayLine:
        return DelayLine(np.asarray(self.delay)[..., None], self.dt_s)

    def first(self, signal: ImuReading) -> Array:
        """The last samples, newest first, shape (..., length, 1, 10)."""
        return self._line.filled(_sample(signal))

    def apply(self, signal: ImuReading, time_s: Array, state: Array) -> tuple[ImuReading, Array]:
        """Reports the sample of `delay` ago, in between two samples their mean."""
        del time_s
        late, line = self._line.pushed(_sample(signal), self.first(signal) if state is None else state)
        late = late[..., 0, :]
        quaternion = late[..., :4]
        if self._is_late:
            quaternion = quaternion / namespace(quaternion).linalg.vector_norm(quaternion, axis=-1, keepdims=True)
        reading = ImuReading(
            quaternion_base_in_world=quaternion,
            angular_velocity_base=late[..., 4:7],
            acceleration_base=late[..., 7:],
        )
        return reading, line


def _sample(reading: ImuReading) -> Array:
    parts = [reading.quaternion_base_in_world, reading.angular_velocity_base, reading.acceleration_base]
    return namespace(parts[0]).concat(parts, axis=-1)[..., None, :]
