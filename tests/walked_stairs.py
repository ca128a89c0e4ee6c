"""A robot carried up stairs in simulation: what its camera sees,
what it tells of itself, and the true ground.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from saltus.depth import Intrinsics, depth_frame, depth_in_millimetres
from saltus.grid import HeightGrid
from saltus.render.backends import make_renderer, preference
from saltus.render.camera import RobotCamera
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.setup import Setup
from saltus.states import standing_state
from saltus.wire.messages import DepthFrame, RobotState

LENS = Intrinsics(width=120, height=72, fx=63.0, fy=63.0, cx=60.0, cy=36.0)
STEP_S, STEP_NS = 0.01, 10_000_000
EVERY = 5
"""Steps from one image to the next: 20 Hz."""
LATE = 5
"""Steps from exposure to arrival."""
SPEED_MPS = 0.6
FAST = 1.03
"""Odometry adds up more than the robot goes."""


@dataclass(frozen=True, kw_only=True)
class Tick:
    """A state with the image that is due with it."""

    state: RobotState
    frame: DepthFrame | None
    position: np.ndarray
    """True place of the base [m]."""
    truth: np.ndarray
    """Heights of the grid relative to the base [m]."""


def carried(setup: Setup, grid: HeightGrid, steps: int) -> Iterator[Tick]:
    """Ticks of a robot that is carried along the course,
    its trunk as high above the ground as it stands.

    Its feet hang straight below the hips; those that touch the ground within 1 cm are told to
    stand.
    """
    robot, terrain = setup.robot, setup.terrain
    renderer = make_renderer(preference(LENS)[0], terrain, RobotCamera.on(robot, LENS))
    legs, yaw = LegKinematics(robot), np.zeros(())
    poses = [_pose(setup, step) for step in range(steps)]
    joints = [_joints(robot, legs, setup, *pose) for pose in poses]
    due: int = -1
    for step, (position, quaternion) in enumerate(poses):
        frame = None
        if step % EVERY == 0 and step >= LATE:
            there = poses[step - LATE], joints[step - LATE][0]
            image = depth_in_millimetres(renderer.render(*there[0], there[1]))
            due = step // EVERY - 1
            frame = depth_frame(LENS, image, time_ns=(step - LATE) * STEP_NS, frame_id=due)
        pitch, lift = _slope(setup, step)
        velocity = np.array([FAST * SPEED_MPS, 0.0, lift])
        state = replace(
            standing_state(robot), time_ns=step * STEP_NS, step=step,
            quaternion_base_in_world=quaternion,
            angular_velocity_base=np.array([0.0, (_slope(setup, step + 1)[0] - pitch) / STEP_S,
                0.0]),
            joint_position=joints[step][0], velocity_base_in_world=velocity,
            leg_trusted=joints[step][1],
            depth_due=due,
        )  # fmt: skip
        x, y = grid.points_in_world(position, yaw)
        yield Tick(
            state=state,
            frame=frame,
            position=position,
            truth=np.asarray(terrain.height_at(x, y)) - position[2],
        )


def _ground(setup: Setup, x: float) -> float:
    """The course as a long robot feels it [m]: its mean over 0.8 m."""
    along = x + np.linspace(-0.4, 0.4, 33)
    return float(np.mean(setup.terrain.height_at(along, 0.0 * along)))


def _x(setup: Setup, step: int) -> float:
    return setup.terrain.first_edge_x - 0.8 + SPEED_MPS * STEP_S * step


def _slope(setup: Setup, step: int) -> tuple[float, float]:
    """Pitch [rad], and how fast the trunk is lifted [m/s]."""
    low, high = (_ground(setup, _x(setup, step + by)) for by in (-1, 1))
    rate = (high - low) / (2.0 * STEP_S)
    return -float(np.arctan(rate / SPEED_MPS)), rate


def _pose(setup: Setup, step: int) -> tuple[np.ndarray, np.ndarray]:
    x = _x(setup, step)
    half = 0.5 * _slope(setup, step)[0]
    position = np.array([x, 0.0, _ground(setup, x) + setup.robot.stand_height])
    return position, np.array([np.cos(half), 0.0, np.sin(half), 0.0])


def _joints(
    robot: Robot, legs: LegKinematics, setup: Setup, *pose: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Angles of legs whose feet are on the ground below the hips,
    where they reach it, and which do.
    """
    position, quaternion = pose
    sine, cosine = 2.0 * quaternion[0] * quaternion[2], 1.0 - 2.0 * quaternion[2] ** 2
    turn = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    hips = (
        position + (robot.hip_anchor + np.outer(robot.abduction_offset, [0.0, 1.0, 0.0])) @ turn.T
    )
    wanted = hips.copy()
    wanted[:, 2] = np.asarray(setup.terrain.height_at(hips[:, 0], hips[:, 1])) + robot.foot_radius
    angles = np.clip(legs.inverse((wanted - position) @ turn), robot.joint_lower, robot.joint_upper)
    reached = position + legs.position(angles) @ turn.T
    return angles, np.linalg.norm(reached - wanted, axis=-1) < 0.01
