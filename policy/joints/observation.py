"""The observation of a policy that commands joints: one vector, as its description orders it.

Training and robot make it by the same lines, for any leading batch dimensions, numpy or torch.
"""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Array, Constant, Floats, Joints, Places, Points, namespace
from saltus.policy.joints.description import ObservationPart, PolicyDescription
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import JOINTS, Robot

LIMIT = 100.0
"""Entries of the vector are cut off beyond this, to either side; legged_gym's."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WalkerReadings:
    """Readings and memory of a walking robot; arrays of shape (..., k), joints in our order."""

    angular_velocity: Places
    """Base frame [rad/s], shape (..., 3)."""
    gravity: Places
    """Direction of gravity in the base frame, a unit vector, shape (..., 3)."""
    command: Places
    """Velocity ahead and to the left [m/s], turning to the left [rad/s], shape (..., 3)."""
    joint_position: Joints
    """[rad], shape (..., 12)."""
    joint_velocity: Joints
    """[rad/s], shape (..., 12)."""
    action: Joints
    """The policy's last one, in the policy's own order, shape (..., 12)."""
    heights: Points
    """Ground above the base at the points of the policy's grid [m], shape (..., points)."""
    linear_velocity: Places | None = None
    """Estimate, base frame [m/s], shape (..., 3); None where no part tells it."""


class ObservationMaker:
    """Makes the observation vector of a policy by its description, without its history."""

    def __init__(self, description: PolicyDescription) -> None:
        self._parts, self._dialect = description.observation, description.dialect
        self._pose, self._grid = Constant(description.pose), description.height_grid()
        order = description.order
        self._order = None if order == list(range(len(JOINTS))) else order
        self._scales = {part.name: Constant(np.asarray(part.scale)) for part in self._parts}

    def vector(self, given: WalkerReadings) -> Array:
        """The policy's vector, shape (..., size), within `LIMIT`."""
        told = [self._told(part, self._value(part, given)) for part in self._parts]
        return namespace(given.gravity).concat(told, axis=-1).clip(-LIMIT, LIMIT)

    def _value(self, part: ObservationPart, given: WalkerReadings) -> Array:
        if part.name == "joint_position":
            offset = given.joint_position - self._pose.like(given.joint_position)
            return self._ordered(offset)
        if part.name == "joint_velocity":
            return self._ordered(given.joint_velocity)
        if part.name == "heights":
            return self._dialect.observation(given.heights, self._grid)
        return getattr(given, part.name)

    def _told(self, part: ObservationPart, value: Array) -> Array:
        if part.clip < np.inf:
            value = value.clip(-part.clip, part.clip)
        return value if part.scale == 1.0 else value * self._scales[part.name].like(value)

    def _ordered(self, joints: Joints) -> Joints:
        return joints if self._order is None else joints[..., self._order]


def standing_height(robot: Robot, pose: Floats) -> float:
    """Height of the base above level ground in a pose [m]: what a blind policy is told."""
    feet = LegKinematics(robot).position(pose)
    return robot.foot_radius - float(feet[:, 2].min())


def gravity_in_base(rotation: Array) -> Array:
    """Direction of gravity in the base frame, shape (..., 3), of rotations base to world."""
    return -rotation[..., 2, :]


def in_command_frame(velocity: Places, rotation: Array) -> Places:
    """A velocity of the world in the frame of commands: ahead, to the left, up; shape (..., 3).

    Args:
        velocity: World frame [m/s], shape (..., 3).
        rotation: Base to world, shape (..., 3, 3).
    """
    xp = namespace(velocity)
    ahead = rotation[..., :2, 0]
    unit = ahead / xp.sqrt(xp.sum(ahead * ahead, axis=-1))[..., None]
    cosine, sine = unit[..., 0], unit[..., 1]
    x, y = velocity[..., 0], velocity[..., 1]
    return xp.stack([cosine * x + sine * y, cosine * y - sine * x, velocity[..., 2]], -1)


def joint_targets(pose: Array, scale: Array | float, action: Joints) -> Joints:
    """The angles that an action asks for [rad], shape (..., 12)."""
    return pose + scale * action
