"""Runs the heightmap service over recorded depth again."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from saltus import go1, kinematics, rotations
from saltus.constants import GRAVITY
from saltus.heightmap.service.service import HeightmapService
from saltus.wire.messages import ControllerMode, DepthFrame, Heightmap, RobotState
from saltus.wire.topics import CAMERA_LATENCY_S


class Predictor(Protocol):
    """Anything that answers each robot state with a heightmap, as a `HeightmapService` does."""

    def step(self, state: RobotState, frame: DepthFrame | None, now_ns: int) -> Heightmap:
        """Advances by one tick; `frame` has arrived since the last call."""
        ...


@dataclass(frozen=True, kw_only=True)
class AssumeLevel:
    """Stands in for the robot of a recording without one: it stands still, level, on the ground below the camera."""

    base_height_m: float = go1.STAND_HEIGHT
    camera_pitch_deg: float = float(np.rad2deg(go1.CAMERA_PITCH))
    """How far the camera looks down. The trunk is taken to be pitched by what this differs from the mount's angle."""

    def states(self, frames: Iterable[DepthFrame]) -> list[RobotState]:
        """One state for every frame, at the time at which a robot would have used it."""
        pitch = np.deg2rad(self.camera_pitch_deg) - go1.CAMERA_PITCH
        zero = np.asarray(0.0)
        quaternion = rotations.quaternion_from_roll_pitch_yaw(zero, np.asarray(pitch), zero)
        joints = self._joints(quaternion)
        latency_ns = round(1e9 * CAMERA_LATENCY_S)
        return [
            _standing(step, frame.time_ns + latency_ns, quaternion, joints, self.base_height_m)
            for step, frame in enumerate(frames)
        ]

    def _joints(self, quaternion: np.ndarray) -> np.ndarray:
        """Legs straight below the hips, feet on the ground."""
        rotation = rotations.rotation_matrix(quaternion)
        hips = (go1.HIP_ANCHOR + np.outer(go1.SIDE, [0.0, go1.ABDUCTION_LENGTH, 0.0])) @ rotation.T
        hips[:, 2] = go1.FOOT_RADIUS - self.base_height_m
        return np.clip(kinematics.inverse_kinematics(hips @ rotation), go1.JOINT_LOWER, go1.JOINT_UPPER)


def replay_frames(
    model_path: Path,
    frames: Sequence[DepthFrame],
    robot: Sequence[RobotState] | AssumeLevel,
    arrival_ns: Sequence[int] | None = None,
) -> list[Heightmap]:
    """The heightmap at every robot state.

    Args:
        model_path: ONNX file.
        frames: In order of capture.
        robot: Recorded states, in order of time and in the clock of the frames; or a stand-in, which has one state
            for each frame.
        arrival_ns: When each frame could first be used; 50 ms after its capture, as on the robot, where not given.

    Returns:
        One heightmap for each state.
    """
    states = robot.states(frames) if isinstance(robot, AssumeLevel) else robot
    if arrival_ns is None:
        arrival_ns = [frame.time_ns + round(1e9 * CAMERA_LATENCY_S) for frame in frames]
    return replay_predictor(HeightmapService(model_path), frames, states, arrival_ns)


def replay_predictor(
    predictor: Predictor, frames: Sequence[DepthFrame], states: Sequence[RobotState], arrival_ns: Sequence[int]
) -> list[Heightmap]:
    """The same for any predictor; it has not been used before."""
    heightmaps = []
    following = 0
    for state in states:
        newest = None
        while following < len(frames) and arrival_ns[following] <= state.time_ns:
            newest = frames[following]
            following += 1
        heightmaps.append(predictor.step(state, newest, state.time_ns))
    return heightmaps


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
