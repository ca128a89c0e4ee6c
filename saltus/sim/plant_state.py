"""States that a plant reports about its robots."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.effects.imu import ImuReading
from saltus.states import SensorArrays


@dataclass(frozen=True, kw_only=True, eq=False)
class PlantState:
    """The robot at one instant; shapes are for one robot, a batch has a leading dimension.

    Never changes later.
    """

    time_s: float | Floats
    """Since the last reset of the robot [s], shape ()."""
    position_base_in_world: Floats
    """Position of the base origin [m], shape (3,)."""
    quaternion_base_in_world: Floats
    """(w, x, y, z), shape (4,)."""
    velocity_base_in_world: Floats
    """Velocity of the base origin [m/s], shape (3,)."""
    angular_velocity_base: Floats
    """Base frame [rad/s], shape (3,)."""
    acceleration_base: Floats
    """Reading of an accelerometer at the base origin: mean specific force over the last physics
    step, in the present base frame [m/s^2], shape (3,)."""
    joint_position: Floats
    """[rad], shape (12,)."""
    joint_velocity: Floats
    """[rad/s], shape (12,)."""
    joint_torque: Floats
    """Torque that the drives believed they applied in the last step [Nm], shape (12,)."""
    foot_force: Floats
    """Vertical ground reaction, mean over the last step [N], shape (4,)."""
    foot_position_in_world: Floats
    """Centres of the foot spheres [m], shape (4, 3)."""
    trunk_contact: NDArray[np.bool_] | np.bool_ | bool
    """True where trunk, payload or a hip touched the terrain in the last step, shape ()."""


def sensor_arrays(state: PlantState, imu: ImuReading) -> SensorArrays:
    """Readings of the robots' IMUs and encoders."""
    return SensorArrays(
        **vars(imu), joint_position=state.joint_position, joint_velocity=state.joint_velocity
    )
