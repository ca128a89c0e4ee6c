"""Turns the motion of robots into episodes to train on: what they felt, saw, and should have known."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from heightmap.shards import Episode
from saltus import kinematics
from saltus.depth import depth_in_millimetres
from saltus.grid import HEIGHTMAP_X
from saltus.messages import Floats
from saltus.terrain.terrain import Terrain

FRAME_TICKS = 2  # camera at 50 Hz
MOUNT_PITCH_ERROR = np.deg2rad(1.5)  # a printed mount and its screws
MOUNT_POSITION_ERROR_M = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """One robot's motion on one terrain, one row per tick of 10 ms: the truth, and what the robot felt."""

    terrain: Terrain
    position_base_in_world: Floats
    """[m], shape (ticks, 3)."""
    quaternion_base_in_world: Floats
    """Shape (ticks, 4)."""
    joint_position: Floats
    """[rad], shape (ticks, 12)."""
    proprioception: Floats
    """From the robot's own estimates, see `heightmap.features`, shape (ticks, n)."""


class MotionSource(Protocol):
    """Whatever moves robots: a kinematic script, or a planner in the batched plant."""

    def trajectories(self, rng: np.random.Generator, count: int) -> Iterator[Trajectory]:
        """Yields `count` trajectories."""
        ...


@dataclass(frozen=True, kw_only=True)
class MountError:
    """How a robot's camera sits against the drawing, base frame."""

    pitch: float
    """[rad], nose down positive."""
    position: tuple[float, float, float]
    """[m]."""

    @staticmethod
    def draw(rng: np.random.Generator) -> "MountError":
        """Draws the error of one robot."""
        x, y, z = rng.uniform(-MOUNT_POSITION_ERROR_M, MOUNT_POSITION_ERROR_M, 3)
        return MountError(pitch=float(rng.uniform(-MOUNT_PITCH_ERROR, MOUNT_PITCH_ERROR)), position=(x, y, z))


RenderDepth = Callable[[Terrain, MountError, Floats, Floats, Floats], Floats]
"""Terrain, mount error, base positions (n, 3), quaternions (n, 4) and joint positions (n, 12) to depth along the
optical axis [m], infinite where nothing is hit, shape (n, 48, 16)."""


def episodes(source: MotionSource, render: RenderDepth, rng: np.random.Generator, count: int) -> Iterator[Episode]:
    """Lets `source` move `count` robots, takes their pictures and writes down the true heights."""
    for trajectory in source.trajectories(rng, count):
        yield _episode(trajectory, render, MountError.draw(rng))


def true_heights(terrain: Terrain, position: Floats, quaternion: Floats) -> Floats:
    """The profile relative to the base along its yaw. Shapes (..., 3), (..., 4) -> (..., 30)."""
    _, _, yaw = kinematics.roll_pitch_yaw(kinematics.rotation_matrix(quaternion))
    x = position[..., :1] + HEIGHTMAP_X * np.cos(yaw)[..., None]
    return terrain.height_at(x) - position[..., 2:]


def _episode(trajectory: Trajectory, render: RenderDepth, mount: MountError) -> Episode:
    position, quaternion = trajectory.position_base_in_world, trajectory.quaternion_base_in_world
    ticks = np.arange(0, len(position), FRAME_TICKS)
    joints = trajectory.joint_position[ticks]
    depth = render(trajectory.terrain, mount, position[ticks], quaternion[ticks], joints)
    return Episode(
        terrain=trajectory.terrain.kind,
        proprioception=trajectory.proprioception.astype(np.float32),
        height=true_heights(trajectory.terrain, position, quaternion).astype(np.float32),
        depth=depth_in_millimetres(depth),
        frame_tick=ticks.astype(np.int32),
    )
