"""The IMU is mounted askew and its gyroscope drifts."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from saltus.arrays import namespace
from saltus.effects.effect import Effect, PerRobot, parameter
from saltus.effects.imu import ImuReading
from saltus.rotations import quaternion_from_roll_pitch_yaw

GYRO = "angular_velocity_base"


@dataclass(frozen=True, kw_only=True)
class ImuBias(Effect[ImuReading], name="imu_bias", site="imu"):
    """The gyroscope reads (`gyro_x`, `gyro_y`, `gyro_z`) too much; a level base is reported at `roll` and `pitch`."""

    # gyroscopes of this class: 0.01 to 0.05 rad/s; mounts: 0.5 to 2 degrees
    gyro_x: PerRobot = parameter(unit="rad/s", null=0.0, low=-0.5, high=0.5, sought=(-0.3, 0.3), adds_to=(GYRO, 0))
    gyro_y: PerRobot = parameter(unit="rad/s", null=0.0, low=-0.5, high=0.5, sought=(-0.3, 0.3), adds_to=(GYRO, 1))
    gyro_z: PerRobot = parameter(unit="rad/s", null=0.0, low=-0.5, high=0.5, sought=(-0.3, 0.3), adds_to=(GYRO, 2))
    roll: PerRobot = parameter(unit="rad", null=0.0, low=-0.35, high=0.35, sought=(-0.3, 0.3))
    pitch: PerRobot = parameter(unit="rad", null=0.0, low=-0.35, high=0.35, sought=(-0.3, 0.3))

    def apply(self, signal: ImuReading, time_s: float, state: None) -> tuple[ImuReading, None]:
        """Adds the drift, and turns the reported orientation about the base's own axes."""
        signal, _ = super().apply(signal, time_s, state)
        turned = signal.quaternion_base_in_world
        if self._is_askew:
            turned = _product(turned, self._mount(turned))
        return replace(signal, quaternion_base_in_world=turned), None

    @cached_property
    def _is_askew(self) -> bool:
        return bool(np.any(np.not_equal(self.roll, 0.0)) or np.any(np.not_equal(self.pitch, 0.0)))

    def _mount(self, quaternion: Any) -> Any:
        zero = namespace(quaternion).zeros_like(quaternion[..., 0])
        roll, pitch = (zero + self.value(name, quaternion) for name in ("roll", "pitch"))
        return quaternion_from_roll_pitch_yaw(roll, pitch, zero)


def _product(a: Any, b: Any) -> Any:
    """Hamilton product of quaternions (w, x, y, z), shape (..., 4)."""
    aw, ax, ay, az = (a[..., i] for i in range(4))
    bw, bx, by, bz = (b[..., i] for i in range(4))
    return namespace(a).stack(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ),
        -1,
    )
