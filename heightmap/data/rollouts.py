"""Turns the motion of robots into episodes to train on: proprioception, images, and true heights."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus import rotations
from saltus.arrays import Floats
from saltus.depth import depth_in_millimetres
from saltus.depth_camera import DepthCamera
from saltus.grid import LINE, HeightGrid
from saltus.heightmap.data.shards import Episode
from saltus.render.camera import RobotCamera
from saltus.render.embree import EmbreeRenderer
from saltus.terrain.terrain import Terrain


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """One robot's motion on one terrain, one row per tick of 10 ms: the truth, and proprioception."""

    terrain: Terrain
    position_base_in_world: Floats
    """[m], shape (ticks, 3)."""
    quaternion_base_in_world: Floats
    """Shape (ticks, 4)."""
    joint_position: Floats
    """[rad], shape (ticks, 12)."""
    proprioception: Floats
    """From the robot's own estimates, see `saltus.heightmap.service.features`, shape (ticks, n)."""


def true_heights(terrain: Terrain, position: Floats, quaternion: Floats, grid: HeightGrid = LINE) -> Floats:
    """The terrain relative to the base. Shapes (..., 3), (..., 4) -> (..., grid.size)."""
    _, _, yaw = rotations.roll_pitch_yaw(rotations.rotation_matrix(quaternion))
    return terrain.height_at(*grid.points_in_world(position, yaw)) - position[..., 2:]


def episode_of(trajectory: Trajectory, view: RobotCamera, camera: DepthCamera) -> Episode:
    """Takes the pictures of one robot without errors, from where its camera really is, with the true heights."""
    rows = camera.exposures(len(trajectory.joint_position))
    renderer = EmbreeRenderer(trajectory.terrain, view, threads=1)
    depth = renderer.render_batch(
        trajectory.position_base_in_world[rows],
        trajectory.quaternion_base_in_world[rows],
        trajectory.joint_position[rows],
    )
    return labelled(trajectory, depth_in_millimetres(camera.for_model(depth)), camera)


def labelled(trajectory: Trajectory, depth: NDArray[np.uint16], camera: DepthCamera) -> Episode:
    """An episode of the motion and the images [mm] of a robot, shape (frames, 48, 16), with the true heights."""
    position, quaternion = trajectory.position_base_in_world, trajectory.quaternion_base_in_world
    return Episode(
        terrain=trajectory.terrain.kind,
        proprioception=trajectory.proprioception.astype(np.float32),
        height=true_heights(trajectory.terrain, position, quaternion).astype(np.float32),
        depth=depth,
        frame_tick=camera.exposures(len(position)),
    )
