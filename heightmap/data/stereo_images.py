"""Images of recorded motion as a D435i takes them: the fast stereo chain for many robots at once."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from saltus.depth import MODEL_CAMERA, depth_in_millimetres
from saltus.heightmap.data.delivery import FRAME_TICKS, TICK_S
from saltus.heightmap.data.rollouts import Trajectory
from saltus.render.camera import RobotCamera
from saltus.render.randomisation import drawn_cameras
from saltus.render.stereo.camera import StereoCamera
from saltus.render.stereo.model_view import COLUMNS, ROWS, pooled, sampled_model_camera
from saltus.render.stereo.optics import Optics
from saltus.render.stereo_embree import StereoEmbree

SAMPLED = sampled_model_camera(ROWS, COLUMNS)
OPTICS = Optics.of(SAMPLED)
CHUNK = 64  # robots that are worked on together: their arrays of 600 kB stay in the processor's cache


def stereo_images(
    trajectories: Sequence[Trajectory], views: Sequence[RobotCamera], rng: np.random.Generator
) -> list[NDArray[np.uint16]]:
    """Takes pictures of robots, one every `FRAME_TICKS`; the generator draws the quality of each camera and its errors.

    Each view is a camera as it really is, of the claimed resolution of `SAMPLED`. Returns depth of each robot [mm], 0
    where invalid, shape (frames, 48, 16).
    """
    images: list[NDArray[np.uint16]] = []
    for first in range(0, len(trajectories), CHUNK):
        part = slice(first, first + CHUNK)
        images += _chunk(trajectories[part], views[part], rng)
    return images


def _chunk(
    trajectories: Sequence[Trajectory], views: Sequence[RobotCamera], rng: np.random.Generator
) -> list[NDArray[np.uint16]]:
    """The same for as many robots as the arrays of one exposure fit into the cache."""
    seen = [_seen(trajectory, view) for trajectory, view in zip(trajectories, views, strict=True)]
    count, frames = len(seen), [len(depth) for depth, _ in seen]
    camera = StereoCamera(drawn_cameras(count, rng), OPTICS)
    state = camera.init((count,), rng)
    images = np.empty((count, max(frames), MODEL_CAMERA.height, MODEL_CAMERA.width), np.uint16)
    for i in range(max(frames)):
        # The camera of a robot whose run is over stands still; what it takes is not kept.
        depth, hidden = (np.stack([pair[kind][min(i, len(pair[kind]) - 1)] for pair in seen]) for kind in (0, 1))
        image, state = camera.step(depth, hidden, np.full(count, i * FRAME_TICKS * TICK_S), state)
        images[:, i] = depth_in_millimetres(pooled(image.depth, ROWS, COLUMNS))
    return [taken[:length] for taken, length in zip(images, frames, strict=True)]


def _seen(trajectory: Trajectory, view: RobotCamera) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """True depth and what the second imager does not see, at each image of a robot."""
    rows = slice(None, None, FRAME_TICKS)
    return StereoEmbree(trajectory.terrain, OPTICS, view).render_pair_batch(
        trajectory.position_base_in_world[rows],
        trajectory.quaternion_base_in_world[rows],
        trajectory.joint_position[rows],
    )
