"""What a planner reads of the robot: quantities of the sagittal plane, derived from what a robot can know."""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Array
from saltus.kinematics import foot_position, roll_pitch_yaw, rotation_matrix, yaw_rotation
from saltus.wire.messages import RobotState


@dataclass(frozen=True, kw_only=True, eq=False)
class Observation:
    """The robot in its yaw frame; all arrays share their leading batch dimensions."""

    roll: Array
    """[rad], shape (...)."""
    pitch: Array
    """Nose down positive [rad], shape (...)."""
    angular_velocity: Array
    """Yaw frame [rad/s], shape (..., 3)."""
    velocity: Array
    """Estimated velocity of the base, yaw frame [m/s], shape (..., 3)."""
    base_height: Array
    """Estimated height of the base above the feet in stance [m], shape (...)."""
    foot: Array
    """Foot centres relative to the base, yaw frame [m], shape (..., 4, 3)."""
    contact: Array
    """Scheduled contact, bool, shape (..., 4)."""
    progress: Array
    """Of the present stance or swing, [0, 1], shape (..., 4)."""


def observe(
    *,
    quaternion_base_in_world: Array,
    angular_velocity_base: Array,
    joint_position: Array,
    velocity_base_in_world: Array,
    base_height: Array,
    leg_contact: Array,
    leg_progress: Array,
) -> Observation:
    """Derives the observation from the fields of `RobotState` with the same names; numpy and torch, any batch."""
    rotation = rotation_matrix(quaternion_base_in_world)
    roll, pitch, yaw = roll_pitch_yaw(rotation)
    world_in_yaw = yaw_rotation(yaw).mT
    base_in_yaw = world_in_yaw @ rotation
    return Observation(
        roll=roll,
        pitch=pitch,
        angular_velocity=(base_in_yaw @ angular_velocity_base[..., None])[..., 0],
        velocity=(world_in_yaw @ velocity_base_in_world[..., None])[..., 0],
        base_height=base_height,
        foot=foot_position(joint_position) @ base_in_yaw.mT,
        contact=leg_contact,
        progress=leg_progress,
    )


def observe_message(state: RobotState) -> Observation:
    """The observation of a single robot from its message."""
    return observe(
        quaternion_base_in_world=np.asarray(state.quaternion_base_in_world, dtype=np.float64),
        angular_velocity_base=np.asarray(state.angular_velocity_base, dtype=np.float64),
        joint_position=np.asarray(state.joint_position, dtype=np.float64),
        velocity_base_in_world=np.asarray(state.velocity_base_in_world, dtype=np.float64),
        base_height=np.asarray(state.base_height, dtype=np.float64),
        leg_contact=np.asarray(state.leg_contact),
        leg_progress=np.asarray(state.leg_progress, dtype=np.float64),
    )
