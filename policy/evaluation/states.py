"""The states of many robots at one instant."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus.wire.messages import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotStates:
    """What a batch of robots knows: the fields of `RobotState`, each with a leading dimension n."""

    time_s: float
    step: int
    quaternion_base_in_world: Floats
    angular_velocity_base: Floats
    acceleration_base: Floats
    joint_position: Floats
    joint_velocity: Floats
    velocity_base_in_world: Floats
    base_height: Floats
    leg_contact: NDArray[np.bool_]
    leg_progress: Floats
    leg_trusted: NDArray[np.bool_]
    cycle: Floats
