"""Turns the motion of robots into episodes to train on: what they felt, saw, and should have known."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from saltus import rotations
from saltus.arrays import Floats
from saltus.depth import MODEL_CAMERA, Intrinsics, depth_in_millimetres
from saltus.effects.camera import ViewChain
from saltus.grid import LINE, HeightGrid
from saltus.heightmap.data.delivery import FRAME_TICKS
from saltus.heightmap.data.mounts import random_mount
from saltus.heightmap.data.shards import Episode, ShardRecord, open_shard
from saltus.render.camera import Mount, moved_camera
from saltus.render.embree import EmbreeRenderer
from saltus.terrain.terrain import Terrain


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
    """From the robot's own estimates, see `saltus.heightmap.service.features`, shape (ticks, n)."""


class MotionSource(Protocol):
    """Whatever moves robots."""

    def trajectories(self, rng: np.random.Generator, count: int) -> Iterator[Trajectory]:
        """Yields `count` trajectories."""
        ...


def collect(
    directory: Path,
    source: MotionSource,
    *,
    count: int,
    seed: int,
    config: dict[str, Any],
    view: ViewChain | None = None,
    done: Callable[[], object] = lambda: None,
) -> ShardRecord:
    """Adds a round of `count` episodes to a dataset; where it is interrupted, those that are whole.

    Args:
        directory: The dataset.
        source: What moves the robots.
        count: Number of episodes.
        seed: Of everything that is drawn.
        config: What made them, for the manifest; plain JSON values.
        view: Where cameras sit and how wide they look, where it is not as claimed.
        done: Is called after each episode.

    Raises:
        KeyboardInterrupt: it was interrupted before the first episode was whole.
    """
    with open_shard(directory, seed=seed, config=config) as shard:
        try:
            shard.append(_told(episodes(source, np.random.default_rng(seed), count, view), done))
        except KeyboardInterrupt:
            if not shard.ticks:
                raise
    return shard.record


def _told(made: Iterable[Episode], done: Callable[[], object]) -> Iterator[Episode]:
    for episode in made:
        yield episode
        done()


def episodes(
    source: MotionSource, rng: np.random.Generator, count: int, view: ViewChain | None = None
) -> Iterator[Episode]:
    """Lets `source` move `count` robots, takes their pictures and writes down the true heights."""
    for trajectory in source.trajectories(rng, count):
        camera, mount = moved_camera(view or ViewChain(), MODEL_CAMERA, random_mount(rng))
        yield episode_of(trajectory, mount, camera=camera)


def true_heights(terrain: Terrain, position: Floats, quaternion: Floats, grid: HeightGrid = LINE) -> Floats:
    """The terrain relative to the base. Shapes (..., 3), (..., 4) -> (..., grid.size)."""
    _, _, yaw = rotations.roll_pitch_yaw(rotations.rotation_matrix(quaternion))
    return terrain.height_at(*grid.points_in_world(position, yaw)) - position[..., 2:]


def episode_of(
    trajectory: Trajectory, mount: Mount, threads: int | None = None, camera: Intrinsics = MODEL_CAMERA
) -> Episode:
    """Takes the pictures of one robot with a camera that sits as `mount` says, and writes down the true heights."""
    rows = slice(None, None, FRAME_TICKS)
    renderer = EmbreeRenderer(trajectory.terrain, camera, mount, threads=threads)
    depth = renderer.render_batch(
        trajectory.position_base_in_world[rows],
        trajectory.quaternion_base_in_world[rows],
        trajectory.joint_position[rows],
    )
    return labelled(trajectory, depth_in_millimetres(depth))


def labelled(trajectory: Trajectory, depth: NDArray[np.uint16]) -> Episode:
    """An episode of the motion and the images [mm] of a robot, shape (frames, 48, 16), with the true heights."""
    position, quaternion = trajectory.position_base_in_world, trajectory.quaternion_base_in_world
    return Episode(
        terrain=trajectory.terrain.kind,
        proprioception=trajectory.proprioception.astype(np.float32),
        height=true_heights(trajectory.terrain, position, quaternion).astype(np.float32),
        depth=depth,
        frame_tick=np.arange(0, len(position), FRAME_TICKS, dtype=np.int32),
    )
