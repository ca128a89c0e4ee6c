"""Readings of an IMU, and the effects on them."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from saltus.arrays import Array, Quaternions, Vectors, namespace
from saltus.constants import PHYSICS_DT
from saltus.effects.delay_line import DelayLine
from saltus.effects.effect import Effect, PerRobot, parameter, period
from saltus.rotations import quaternion_from_roll_pitch_yaw, quaternion_product


@dataclass(frozen=True, kw_only=True, eq=False)
class ImuReading:
    """One sample of an IMU. Site "imu"."""

    quaternion_base_in_world: Quaternions
    """(w, x, y, z), shape (..., 4)."""
    angular_velocity_base: Vectors
    """[rad/s], shape (..., 3)."""
    acceleration_base: Vectors
    """Specific force [m/s^2], shape (..., 3)."""


GYRO = "angular_velocity_base"


@dataclass(frozen=True, kw_only=True)
class ImuBias(Effect[ImuReading], name="imu_bias", site="imu"):
    """The gyroscope reads (`gyro_x`, `gyro_y`, `gyro_z`) too much;
    a level base is reported at `roll` and `pitch`.
    """

    # gyroscopes of this class: 0.01 to 0.05 rad/s; mounts: 0.5 to 2 degrees
    gyro_x: PerRobot = parameter(
        unit="rad/s", null=0.0, low=-0.5, high=0.5, sought=(-0.3, 0.3), adds_to=(GYRO, 0)
    )
    gyro_y: PerRobot = parameter(
        unit="rad/s", null=0.0, low=-0.5, high=0.5, sought=(-0.3, 0.3), adds_to=(GYRO, 1)
    )
    gyro_z: PerRobot = parameter(
        unit="rad/s", null=0.0, low=-0.5, high=0.5, sought=(-0.3, 0.3), adds_to=(GYRO, 2)
    )
    roll: PerRobot = parameter(unit="rad", null=0.0, low=-0.35, high=0.35, sought=(-0.3, 0.3))
    pitch: PerRobot = parameter(unit="rad", null=0.0, low=-0.35, high=0.35, sought=(-0.3, 0.3))

    def apply(self, signal: ImuReading, time_s: float, state: None) -> tuple[ImuReading, None]:
        """Adds the drift, and turns the reported orientation about the base's own axes."""
        signal, _ = super().apply(signal, time_s, state)
        turned = signal.quaternion_base_in_world
        if self._is_askew:
            turned = quaternion_product(turned, self._mount(turned))
        return replace(signal, quaternion_base_in_world=turned), None

    @cached_property
    def _is_askew(self) -> bool:
        return bool(np.any(np.not_equal(self.roll, 0.0)) or np.any(np.not_equal(self.pitch, 0.0)))

    def _mount(self, quaternion: Array) -> Array:
        zero = namespace(quaternion).zeros_like(quaternion[..., 0])
        roll, pitch = (zero + self.value(name, quaternion) for name in ("roll", "pitch"))
        return quaternion_from_roll_pitch_yaw(roll, pitch, zero)


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
        late, line = self._line.pushed(
            _sample(signal), self.first(signal) if state is None else state
        )
        late = late[..., 0, :]
        quaternion = late[..., :4]
        if self._is_late:
            quaternion = quaternion / namespace(quaternion).linalg.vector_norm(
                quaternion, axis=-1, keepdims=True
            )
        reading = ImuReading(
            quaternion_base_in_world=quaternion,
            angular_velocity_base=late[..., 4:7],
            acceleration_base=late[..., 7:],
        )
        return reading, line


def _sample(reading: ImuReading) -> Array:
    parts = [
        reading.quaternion_base_in_world,
        reading.angular_velocity_base,
        reading.acceleration_base,
    ]
    return namespace(parts[0]).concat(parts, axis=-1)[..., None, :]
