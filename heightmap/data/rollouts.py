"""Turns the motion of robots into episodes to train on: proprioception, images, and true heights."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus import rotations
from saltus.arrays import Floats, Singles
from saltus.depth import MODEL_CAMERA, depth_in_millimetres
from saltus.depth_camera import DepthCamera
from saltus.effects.image_pixels import to_images
from saltus.effects.profile import Profile
from saltus.grid import LINE, HeightGrid
from saltus.heightmap.data.delivery import TICK_S
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.settings import USUAL_RENDERER
from saltus.render.backends import make_stereo
from saltus.render.camera import RobotCamera
from saltus.render.stereo.optics import Optics
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


def true_images(
    trajectory: Trajectory, view: RobotCamera, camera: DepthCamera, renderer: str = USUAL_RENDERER
) -> NDArray[np.float32]:
    """Images that one robot's camera exposes, from where it really is, without errors [m], shape (frames, 48, 16)."""
    rows = camera.exposures(len(trajectory.joint_position))
    # the left imager of a pair, which takes one thread: other processes have the other cores
    left = make_stereo(renderer, trajectory.terrain, Optics.behind(view.intrinsics, camera), view)
    depth = left.render_batch(
        trajectory.position_base_in_world[rows],
        trajectory.quaternion_base_in_world[rows],
        trajectory.joint_position[rows],
    )
    seen: NDArray[np.float32] = camera.for_model(depth)
    return seen


def labelled(
    trajectory: Trajectory, exposed: Singles, camera: DepthCamera, profile: Profile, rng: np.random.Generator
) -> Episode:
    """An episode of the motion of a robot, with the true heights, and of what its camera gives out.

    Args:
        trajectory: The motion.
        exposed: What the camera exposes [m], shape (frames, 48, 16).
        camera: Its rate.
        profile: What the camera makes of that, and how long it travels.
        rng: Of what effects draw.
    """
    position, quaternion = trajectory.position_base_in_world, trajectory.quaternion_base_in_world
    frame_tick = camera.exposures(len(position))
    chain = to_images(profile, MODEL_CAMERA.fx).camera_chain
    depth, given_s = chain.taken.film(exposed, TICK_S * frame_tick, rng)
    there = np.isfinite(given_s)
    return Episode(
        terrain=trajectory.terrain.kind,
        proprioception=trajectory.proprioception.astype(np.float32),
        height=true_heights(trajectory.terrain, position, quaternion).astype(np.float32),
        depth=depth_in_millimetres(depth[there]),
        frame_tick=frame_tick[there],
        latency=chain.latency,
    )
