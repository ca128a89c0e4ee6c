"""Inputs of the leg controller and what it derives at once:
arrays with any leading batch dimensions.
"""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Array, Constant, Jacobians, Legs, Rotations, Scalars, Vectors, namespace
from saltus.plan import Plan
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import SIDE
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.states import Proprioception

_OUTWARD = Constant(np.stack([np.ones(4), SIDE, np.ones(4)], -1))


@dataclass(frozen=True, kw_only=True, eq=False)
class CentroidalReference:
    """How the robot's body should move and where its feet should step now, in the yaw frame, by the
    plan.
    """

    stepping_frequency: Scalars
    """[Hz], shape (...)."""
    velocity: Vectors
    """Reference velocity of the base, yaw frame [m/s], shape (..., 3)."""
    angular_velocity: Vectors
    """Reference angular velocity, yaw frame [rad/s], shape (..., 3); the yaw rate is added by the
    controller."""
    foot_residual: Legs
    """Added to the nominal swing position of each foot, yaw frame (y to the left) [m], shape (...,
    4, 3)."""
    heading: Scalars
    """Yaw that the robot holds [rad], shape (...).

    Nothing else keeps it on a course: plans have no yaw.
    """


@dataclass(frozen=True, kw_only=True, eq=False)
class YawFrameBody:
    """The robot seen from the yaw frame: all that swing, stance and feedback share."""

    roll: Scalars
    pitch: Scalars
    yaw: Scalars
    """[rad], shape (...) each."""
    base_in_yaw: Rotations
    """Rotation from the base to the yaw frame, shape (..., 3, 3)."""
    velocity: Vectors
    """Velocity of the base, yaw frame [m/s], shape (..., 3)."""
    angular_velocity: Vectors
    """Yaw frame [rad/s], shape (..., 3)."""
    foot_base: Legs
    """Foot centres, base frame [m], shape (..., 4, 3)."""
    foot_yaw: Legs
    """Foot centres relative to the base, yaw frame [m], shape (..., 4, 3)."""
    jacobian: Jacobians
    """Foot Jacobians, base frame [m/rad], shape (..., 4, 3, 3)."""


def reference_of(plan: Plan, heading: Scalars) -> CentroidalReference:
    """The reference that a plan stands for, mirrored between left and right;
    `heading` is the yaw to hold [rad].
    """
    xp = namespace(plan.velocity_x)
    zero = xp.zeros_like(plan.velocity_x)
    front, rear = plan.foot_residual_front, plan.foot_residual_rear
    return CentroidalReference(
        stepping_frequency=plan.stepping_frequency_hz,
        velocity=xp.stack([plan.velocity_x, zero, plan.velocity_z], -1),
        angular_velocity=xp.stack([zero, plan.pitch_rate, zero], -1),
        foot_residual=xp.stack([front, front, rear, rear], -2) * _OUTWARD.like(plan.velocity_x),
        heading=heading,
    )


def observe_body(sensed: Proprioception, legs: LegKinematics) -> YawFrameBody:
    """Attitude, velocities and feet of a robot with these legs,
    in the frames that the controller uses.
    """
    xp = namespace(sensed.joint_position)
    rotation = rotation_matrix(sensed.quaternion_base_in_world)
    roll, pitch, yaw = roll_pitch_yaw(rotation)
    yaw_in_world = _yaw_in_world(xp, rotation)
    base_in_yaw = yaw_in_world.mT @ rotation
    foot_base, jacobian = legs.position_and_jacobian(sensed.joint_position)
    return YawFrameBody(
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        base_in_yaw=base_in_yaw,
        velocity=(sensed.velocity_base_in_world[..., None, :] @ yaw_in_world)[..., 0, :],
        angular_velocity=(sensed.angular_velocity_base[..., None, :] @ base_in_yaw.mT)[..., 0, :],
        foot_base=foot_base,
        foot_yaw=foot_base @ base_in_yaw.mT,
        jacobian=jacobian,
    )


def _yaw_in_world(xp: Array, rotation: Rotations) -> Rotations:
    # From the matrix itself: no second pass through sine and cosine of the yaw. The columns are x,
    # y and z of the yaw frame. Vertical noses (no yaw at all) are outside what the controller may
    # meet: damping begins at 60 deg.
    forward_x, forward_y = rotation[..., 0, 0], rotation[..., 1, 0]
    inverse = 1.0 / xp.sqrt(forward_x * forward_x + forward_y * forward_y)
    c, s = forward_x * inverse, forward_y * inverse
    zero = xp.zeros_like(c)
    rows = xp.stack([c, -s, zero, s, c, zero, zero, zero, zero + 1.0], -1)
    return rows.reshape((*rotation.shape[:-2], 3, 3))
