"""What the network feels: the proprioception vector, built in one place for training and service alike."""

import numpy as np

from saltus import kinematics
from saltus.arrays import Array, namespace
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
    quaternion_base_in_world: Array,
    angular_velocity_base: Array,
    joint_position: Array,
    velocity_base_in_world: Array,
    base_height: Array,
    leg_trusted: Array,
) -> Array:
    """Builds the vector for any leading batch dimensions, numpy or torch.

    The position of a foot says where the ground is while its leg is trusted to stand; otherwise it is zero (original).

    Args:
        quaternion_base_in_world: (w, x, y, z), shape (..., 4).
        angular_velocity_base: [rad/s], shape (..., 3).
        joint_position: [rad], shape (..., 12).
        velocity_base_in_world: estimate [m/s], shape (..., 3).
        base_height: estimate of the base above the feet in stance [m], shape (...).
        leg_trusted: bool, shape (..., 4).

    Returns:
        float32, shape (..., len(PROPRIOCEPTION)).
    """
    xp = namespace(joint_position)
    rotation = kinematics.rotation_matrix(quaternion_base_in_world)
    roll, pitch, yaw = kinematics.roll_pitch_yaw(rotation)
    yaw_from_world = kinematics.yaw_rotation(yaw).mT
    base_to_yaw = yaw_from_world @ rotation
    feet = kinematics.foot_position(joint_position) @ base_to_yaw.mT  # (..., 4, 3)
    trusted = xp.astype(leg_trusted, joint_position.dtype)
    masked = feet[..., ::2] * trusted[..., None]  # x and z
    parts = (
        roll[..., None],
        pitch[..., None],
        masked.reshape((*masked.shape[:-2], 8)),
        trusted,
        _rotate(yaw_from_world, velocity_base_in_world),
        _rotate(base_to_yaw, angular_velocity_base),
        base_height[..., None],
    )
    return xp.astype(xp.concat(parts, axis=-1), xp.float32)


def proprioception_of(state: RobotState) -> Floats:
    """The vector of one robot state, shape (len(PROPRIOCEPTION),)."""
    vector: Floats = proprioception(
        quaternion_base_in_world=np.asarray(state.quaternion_base_in_world, np.float64),
        angular_velocity_base=np.asarray(state.angular_velocity_base, np.float64),
        joint_position=np.asarray(state.joint_position, np.float64),
        velocity_base_in_world=np.asarray(state.velocity_base_in_world, np.float64),
        base_height=np.asarray(state.base_height, np.float64),
        leg_trusted=np.asarray(state.leg_trusted, np.bool_),
    )
    return vector


def _rotate(rotation: Array, vector: Array) -> Array:
    return (rotation @ vector[..., None])[..., 0]
