"""Readings of an IMU."""

from dataclasses import dataclass

from saltus.arrays import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class ImuReading:
    """One sample of an IMU. Site "imu"."""

    quaternion_base_in_world: Floats
    """(w, x, y, z), shape (..., 4)."""
    angular_velocity_base: Floats
    """[rad/s], shape (..., 3)."""
    acceleration_base: Floats
    """Specific force [m/s^2], shape (..., 3)."""
