"""Motion that costs nothing to make, for tests of what is done with motion:
robots glide over the ground.
"""

from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from samples import KINEMATICS, PROFILE, ROBOT

from saltus import rotations
from saltus.config import TerrainConfig
from saltus.depth_camera import SHIPPED
from saltus.grid import LINE
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.randomisation import random_mount
from saltus.heightmap.data.rollouts import RobotTrajectory, film_robots
from saltus.heightmap.service.proprioception_vector import proprioception_of_states
from saltus.render.camera import RobotCamera
from saltus.terrain.curriculum import make_terrain

TICK_S = 0.01
TERRAINS: tuple[str, ...] = ("flat", "stairs", "stepping_stones", "step", "gap")


def gliding_robots(
    rng: np.random.Generator, count: int, *, ticks: int = 150, terrains: tuple[str, ...] = TERRAINS
) -> Iterator[RobotTrajectory]:
    """Yields trajectories of one robot each: stiff legs,
    a base that bobs and nods above the ground.
    """
    for _ in range(count):
        yield _trajectory(rng, ticks, terrains[rng.integers(len(terrains))])


def gliding_episodes(
    count: int, *, seed: int = 0, ticks: int = 150, terrains: tuple[str, ...] = TERRAINS
) -> Iterator[Episode]:
    """The same with true images, as a dataset keeps them."""
    rng = np.random.default_rng(seed)
    for trajectory in gliding_robots(rng, count, ticks=ticks, terrains=terrains):
        view, camera = (
            replace(RobotCamera.on(ROBOT), mount=random_mount(ROBOT, rng)),
            SHIPPED["ideal"],
        )
        yield from film_robots([trajectory], [view], camera, PROFILE, LINE, rng)


def _trajectory(rng: np.random.Generator, ticks: int, kind: str) -> RobotTrajectory:
    terrain = make_terrain(TerrainConfig(terrain=kind, difficulty=float(rng.uniform(0.0, 0.4))))
    time_s = TICK_S * np.arange(ticks)
    x = rng.uniform(0.0, 1.0) + rng.uniform(0.3, 1.5) * time_s
    bob = rng.uniform(0.01, 0.05) * np.sin(
        2.0 * np.pi * (rng.uniform() + time_s / rng.uniform(0.3, 0.6))
    )
    z = np.maximum(terrain.height_at(x, np.zeros_like(x)), 0.0) + ROBOT.stand_height + bob
    position = np.stack([x, np.full_like(x, rng.uniform(-0.3, 0.3)), z], axis=-1)
    pitch = rng.uniform(0.0, 0.2) * np.sin(2.0 * np.pi * time_s / rng.uniform(0.3, 0.6))
    zero = np.zeros_like(x)
    quaternion = rotations.quaternion_from_roll_pitch_yaw(
        zero, pitch, zero + rng.uniform(-0.1, 0.1)
    )
    joints = np.tile(ROBOT.stand_pose, (ticks, 1))
    known: Any = SimpleNamespace(
        quaternion_base_in_world=quaternion,
        angular_velocity_base=np.stack([zero, np.gradient(pitch, TICK_S), zero], axis=-1),
        joint_position=joints,
        velocity_base_in_world=np.gradient(position, TICK_S, axis=0),
        base_height=bob + ROBOT.stand_height,
        leg_trusted=np.ones((ticks, 4), np.bool_),
    )
    return RobotTrajectory(
        terrain=terrain, position_base_in_world=position, quaternion_base_in_world=quaternion,
        joint_position=joints, proprioception=proprioception_of_states(known, KINEMATICS),
    )  # fmt: skip
