"""The description of the policies that Saltus trains: what they read and say, and their pose.

The order is IsaacLab's (`base_ang_vel, projected_gravity, velocity_commands, joint_pos, joint_vel,
actions, height_scan`), without the linear velocity, which no sensor of the robot measures. Scaling
belongs to the network.
"""

from saltus.arrays import Floats
from saltus.dialects import dialect_of
from saltus.grid import SCAN
from saltus.policy.joints.description import ObservationPart, ObservationPartName, PolicyDescription
from saltus.policy.walking.settings import WalkSettings
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import JOINTS, Robot

LAYOUT: dict[ObservationPartName, int] = {
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


def description_of(config: WalkSettings, robot: Robot) -> PolicyDescription:
    """Description of a policy that is trained with this configuration."""
    drives, command = config.drives, config.command
    low, high = command.ahead_mps
    return PolicyDescription(
        robot=robot.name,
        observation=tuple(ObservationPart(name=name) for name in LAYOUT),
        pose_rad=tuple(walking_pose(robot, drives.height).tolist()),
        action_scale_rad=drives.scale,
        action_clip=drives.most,
        kp=drives.kp,
        kd=drives.kd,
        rate_hz=POLICY_HZ,
        dialect=dialect_of(config.dialect),
        blind=config.blind,
        command_low=(low, -command.aside_mps, -command.turn_rps),
        command_high=(high, command.aside_mps, command.turn_rps),
    )


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
