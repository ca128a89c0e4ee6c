"""Images of recorded motion as a stereo camera takes them: the fast stereo chain for many robots at once."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from saltus.depth import MODEL_CAMERA, sampled_model_camera
from saltus.depth_camera import DepthCamera
from saltus.heightmap.data.delivery import TICK_S
from saltus.heightmap.data.rollouts import Trajectory
from saltus.heightmap.settings import USUAL_RENDERER
from saltus.render.backends import make_stereo
from saltus.render.camera import RobotCamera
from saltus.render.randomisation import drawn_cameras
from saltus.render.renderer import StereoRenderer
from saltus.render.stereo.camera import StereoCamera, StereoConfig
from saltus.render.stereo.model_view import COLUMNS, ROWS, pooled
from saltus.render.stereo.optics import Optics

SAMPLED = sampled_model_camera(ROWS, COLUMNS)
CHUNK = 64  # robots that are worked on together: their arrays of 600 kB stay in the processor's cache


def stereo_images(
    trajectories: Sequence[Trajectory],
    views: Sequence[RobotCamera],
    camera: DepthCamera,
    rng: np.random.Generator,
    renderer: str = USUAL_RENDERER,
) -> list[NDArray[np.float32]]:
    """Takes pictures of robots at a camera's rate; the generator draws the quality of each camera and its errors.

    Each view is a camera as it really is, of the claimed resolution of `SAMPLED`. Returns depth of each robot [m], 0
    where invalid, shape (frames, 48, 16).
    """
    images: list[NDArray[np.float32]] = []
    for first in range(0, len(trajectories), CHUNK):
        part = slice(first, first + CHUNK)
        images += _chunk(trajectories[part], views[part], camera, rng, renderer)
    return images


def _chunk(
    trajectories: Sequence[Trajectory],
    views: Sequence[RobotCamera],
    camera: DepthCamera,
    rng: np.random.Generator,
    renderer: str,
) -> list[NDArray[np.float32]]:
    """The same for as many robots as the arrays of one exposure fit into the cache."""
    optics = Optics.behind(SAMPLED, camera)
    seen = [
        _seen(trajectory, make_stereo(renderer, trajectory.terrain, optics, view), camera)
        for trajectory, view in zip(trajectories, views, strict=True)
    ]
    count, frames = len(seen), [len(depth) for depth, _ in seen]
    stereo = StereoCamera(drawn_cameras(count, rng, StereoConfig.of(camera)), optics)
    state = stereo.init((count,), rng)
    times_s = TICK_S * camera.exposures(max(len(trajectory.joint_position) for trajectory in trajectories))
    images = np.empty((count, max(frames), MODEL_CAMERA.height, MODEL_CAMERA.width), np.float32)
    for i, time_s in enumerate(times_s):
        # The camera of a robot whose run is over stands still; what it takes is not kept.
        depth, hidden = (np.stack([pair[kind][min(i, len(pair[kind]) - 1)] for pair in seen]) for kind in (0, 1))
        image, state = stereo.step(depth, hidden, np.full(count, time_s), state)
        images[:, i] = camera.for_model(pooled(image.depth, ROWS, COLUMNS))
    return [taken[:length] for taken, length in zip(images, frames, strict=True)]


def _seen(
    trajectory: Trajectory, pair: StereoRenderer, camera: DepthCamera
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """True depth and what the second imager does not see, at each image of a robot."""
    rows = camera.exposures(len(trajectory.joint_position))
    return pair.render_pair_batch(
        trajectory.position_base_in_world[rows],
        trajectory.quaternion_base_in_world[rows],
        trajectory.joint_position[rows],
    )
