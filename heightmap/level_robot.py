"""A robot that stands still and level: for recordings of a camera without a robot,
and for checks of models.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import tyro

from saltus import rotations
from saltus.config import check_between
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.states import standing_state
from saltus.wire.messages import DepthFrame, RobotState
from saltus.wire.topics import CAMERA_LATENCY_S

OfRobot = Annotated[
    float | None, tyro.conf.arg(metavar="FLOAT", help_behavior_hint="(default: the robot's)")
]


@dataclass(frozen=True, kw_only=True)
class LevelRobot:
    """Tells states of a robot that stands still and level below its camera, for a camera without a
    robot.
    """

    base_height_m: OfRobot = None
    """Height of the base above the ground [m]."""
    camera_pitch_deg: OfRobot = None
    """How far the camera looks down [deg].

    The trunk is taken to be pitched by what this differs from the mount.
    """

    def __post_init__(self) -> None:
        check_between(self, base_height_m=(0.05, 2.0), camera_pitch_deg=(-90.0, 90.0))

    def states(self, robot: Robot, frames: Iterable[DepthFrame]) -> list[RobotState]:
        """One state for every frame, at the time at which a robot would have used it."""
        still, latency_ns = self.state(robot), round(1e9 * CAMERA_LATENCY_S)
        return [
            replace(still, step=i, time_ns=frame.time_ns + latency_ns)
            for i, frame in enumerate(frames)
        ]

    def state(self, robot: Robot) -> RobotState:
        """How it stands, at the beginning of a run."""
        pitch = (
            0.0
            if self.camera_pitch_deg is None
            else np.deg2rad(self.camera_pitch_deg) - robot.camera_pitch
        )
        height = robot.stand_height if self.base_height_m is None else self.base_height_m
        zero = np.asarray(0.0)
        quaternion = rotations.quaternion_from_roll_pitch_yaw(zero, np.asarray(pitch), zero)
        joints = _joints(robot, quaternion, height)
        return replace(
            standing_state(robot),
            quaternion_base_in_world=quaternion,
            joint_position=joints,
            base_height=height,
            leg_progress=np.full(4, 0.5),
        )


def _joints(robot: Robot, quaternion: np.ndarray, height: float) -> np.ndarray:
    """Legs straight below the hips, feet on the ground."""
    rotation = rotations.rotation_matrix(quaternion)
    hips = (robot.hip_anchor + np.outer(robot.abduction_offset, [0.0, 1.0, 0.0])) @ rotation.T
    hips[:, 2] = robot.foot_radius - height
    return np.clip(
        LegKinematics(robot).inverse(hips @ rotation), robot.joint_lower, robot.joint_upper
    )
