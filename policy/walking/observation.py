"""The observation of a walking policy: one vector, in the order in which its ONNX file states it.

The order is IsaacLab's (`base_ang_vel, projected_gravity, velocity_commands, joint_pos, joint_vel,
actions, height_scan`), without the linear velocity, which no sensor of the robot measures. Scaling
belongs to the network.
"""

from dataclasses import dataclass

from saltus.arrays import Array, Constant, Floats, Joints, Places, Points, namespace
from saltus.dialects import Dialect
from saltus.grid import SCAN
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import JOINTS, Robot

LAYOUT: dict[str, int] = {
    "angular_velocity": 3,
    "gravity": 3,
    "command": 3,
    "joint_position": len(JOINTS),
    "joint_velocity": len(JOINTS),
    "action": len(JOINTS),
    "heights": SCAN.size,
}
"""Names of the parts of the vector, in order, and their lengths."""
SIZE = sum(LAYOUT.values())
"""Length of the vector."""
POLICY_HZ = 50
"""Rate of the policy; IsaacLab's, legged_gym's and mjlab's."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensed:
    """Readings and memory of a walking robot; arrays of shape (..., k)."""

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
    """The policy's last one, shape (..., 12)."""
    heights: Points
    """Ground above the base at the points of `saltus.grid.SCAN` [m], shape (..., 187)."""


class Observer:
    """Makes the vector for one pose and one dialect of heights; numpy or torch."""

    def __init__(self, pose: Floats, dialect: Dialect) -> None:
        self._pose, self._dialect = Constant(pose), dialect

    def vector(self, given: Sensed) -> Array:
        """The policy's vector, shape (..., SIZE)."""
        parts = {
            "angular_velocity": given.angular_velocity,
            "gravity": given.gravity,
            "command": given.command,
            "joint_position": given.joint_position - self._pose.like(given.joint_position),
            "joint_velocity": given.joint_velocity,
            "action": given.action,
            "heights": self._dialect.observation(given.heights, SCAN),
        }
        return namespace(given.heights).concat([parts[name] for name in LAYOUT], axis=-1)


def walking_pose(robot: Robot, height: float) -> Floats:
    """Joint angles with each foot below its thigh's axis [rad], shape (12,).

    Args:
        robot: Which one.
        height: Of that axis above the foot's centre, by the length of the leg, from 0 to 1.
    """
    foot = robot.hip_anchor.copy()
    foot[:, 1] += robot.abduction_offset
    foot[:, 2] -= height * robot.leg_length
    return LegKinematics(robot).inverse(foot)


def gravity_in_base(rotation: Array) -> Array:
    """Direction of gravity in the base frame, shape (..., 3), of rotations base to world."""
    return -rotation[..., 2, :]
