"""What the network feels: the proprioception vector, built in one place for training and service alike."""

import numpy as np
from numpy.typing import NDArray

from saltus import kinematics
from saltus.messages import Floats, RobotState

PROPRIOCEPTION = (
    "roll",
    "pitch",
    *(f"{leg}_foot_{axis}" for leg in ("FR", "FL", "RR", "RL") for axis in "xz"),
    *(f"{leg}_trusted" for leg in ("FR", "FL", "RR", "RL")),
    *(f"velocity_{axis}" for axis in "xyz"),
    *(f"angular_velocity_{axis}" for axis in "xyz"),
    "base_height",
)
"""Names of the entries. Angles [rad], positions [m] and velocities [m/s, rad/s] in the yaw frame."""


def proprioception(
    *,
    quaternion_base_in_world: Floats,
    angular_velocity_base: Floats,
    joint_position: Floats,
    velocity_base_in_world: Floats,
    base_height: Floats,
    leg_trusted: NDArray[np.bool_],
) -> Floats:
    """Builds the vector for any leading batch dimensions.

    The position of a foot says where the ground is while its leg is trusted to stand; otherwise it is zero (original).

    Args:
        quaternion_base_in_world: (w, x, y, z), shape (..., 4).
        angular_velocity_base: [rad/s], shape (..., 3).
        joint_position: [rad], shape (..., 12).
        velocity_base_in_world: estimate [m/s], shape (..., 3).
        base_height: estimate of the base above the feet in stance [m], shape (...).
        leg_trusted: shape (..., 4).

    Returns:
        float32, shape (..., len(PROPRIOCEPTION)).
    """
    rotation = kinematics.rotation_matrix(np.asarray(quaternion_base_in_world, np.float64))
    roll, pitch, yaw = kinematics.roll_pitch_yaw(rotation)
    yaw_from_world = np.swapaxes(kinematics.yaw_rotation(yaw), -1, -2)
    base_to_yaw = yaw_from_world @ rotation
    feet_base = kinematics.foot_position(np.asarray(joint_position, np.float64))
    feet = feet_base @ np.swapaxes(base_to_yaw, -1, -2)  # (..., 4, 3)
    trusted = np.asarray(leg_trusted, np.float64)
    masked = feet[..., [0, 2]] * trusted[..., None]
    parts = (
        roll[..., None],
        pitch[..., None],
        masked.reshape(*masked.shape[:-2], 8),
        trusted,
        _rotate(yaw_from_world, velocity_base_in_world),
        _rotate(base_to_yaw, angular_velocity_base),
        np.asarray(base_height)[..., None],
    )
    return np.concatenate(parts, -1).astype(np.float32)


def proprioception_of(state: RobotState) -> Floats:
    """The vector of one robot state, shape (len(PROPRIOCEPTION),)."""
    return proprioception(
        quaternion_base_in_world=state.quaternion_base_in_world,
        angular_velocity_base=state.angular_velocity_base,
        joint_position=state.joint_position,
        velocity_base_in_world=state.velocity_base_in_world,
        base_height=np.asarray(state.base_height),
        leg_trusted=state.leg_trusted,
    )


def _rotate(rotation: Floats, vector: Floats) -> Floats:
    return (rotation @ np.asarray(vector)[..., None])[..., 0]
