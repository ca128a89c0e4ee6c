"""A robot that stands still and level: for recordings of a camera without a robot, and for checks of models."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import tyro

from saltus import rotations
from saltus.config import check_between
from saltus.constants import GRAVITY
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.wire.messages import ControllerMode, DepthFrame, RobotState
from saltus.wire.topics import CAMERA_LATENCY_S

OfRobot = Annotated[float | None, tyro.conf.arg(metavar="FLOAT", help_behavior_hint="(default: the robot's)")]


@dataclass(frozen=True, kw_only=True)
class LevelRobot:
    """Stands still and level on the ground below the camera."""

    base_height_m: OfRobot = None
    """Height of the base above the ground [m]."""
    camera_pitch_deg: OfRobot = None
    """How far the camera looks down [deg]. The trunk is taken to be pitched by what this differs from the mount."""

    def __post_init__(self) -> None:
        check_between(self, base_height_m=(0.05, 2.0), camera_pitch_deg=(-90.0, 90.0))

    def states(self, robot: Robot, frames: Iterable[DepthFrame]) -> list[RobotState]:
        """One state for every frame, at the time at which a robot would have used it."""
        pitch = 0.0 if self.camera_pitch_deg is None else np.deg2rad(self.camera_pitch_deg) - robot.camera_pitch
        height = robot.stand_height if self.base_height_m is None else self.base_height_m
        zero = np.asarray(0.0)
        quaternion = rotations.quaternion_from_roll_pitch_yaw(zero, np.asarray(pitch), zero)
        joints = _joints(robot, quaternion, height)
        latency_ns = round(1e9 * CAMERA_LATENCY_S)
        return [
            _standing(step, frame.time_ns + latency_ns, quaternion, joints, height) for step, frame in enumerate(frames)
        ]


def _joints(robot: Robot, quaternion: np.ndarray, height: float) -> np.ndarray:
    """Legs straight below the hips, feet on the ground."""
    rotation = rotations.rotation_matrix(quaternion)
    hips = (robot.hip_anchor + np.outer(robot.abduction_offset, [0.0, 1.0, 0.0])) @ rotation.T
    hips[:, 2] = robot.foot_radius - height
    return np.clip(LegKinematics(robot).inverse(hips @ rotation), robot.joint_lower, robot.joint_upper)


def _standing(step: int, time_ns: int, quaternion: np.ndarray, joints: np.ndarray, base_height: float) -> RobotState:
    return RobotState(
        time_ns=time_ns,
        step=step,
        quaternion_base_in_world=quaternion,
        angular_velocity_base=np.zeros(3),
        acceleration_base=np.array([0.0, 0.0, GRAVITY]),
        joint_position=joints,
        joint_velocity=np.zeros(12),
        joint_torque=np.zeros(12),
        velocity_base_in_world=np.zeros(3),
        base_height=base_height,
        leg_contact=np.ones(4, np.bool_),
        leg_progress=np.full(4, 0.5),
        leg_trusted=np.ones(4, np.bool_),
        cycle=0,
        mode=ControllerMode.STAND,
        depth_due=-1,
    )
