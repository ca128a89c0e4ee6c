"""Turns the motion of robots into episodes to train on:
proprioception, images, and true heights.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import AnyArray, Floats, Singles
from saltus.depth import MODEL_CAMERA
from saltus.depth_camera import DepthCamera
from saltus.effects.effect import stack_states
from saltus.effects.image_pixels import to_images
from saltus.effects.profile import Profile
from saltus.grid import HeightGrid
from saltus.heightmap.data.delivery import TICK_S
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.settings import USUAL_RENDERER
from saltus.loop.heights import true_heights
from saltus.render.backends import make_stereo
from saltus.render.camera import RobotCamera
from saltus.render.eyes import SAMPLED, Eyes
from saltus.render.randomisation import drawn_cameras
from saltus.render.stereo.camera import StereoCamera, StereoConfig, StereoState
from saltus.render.stereo.optics import StereoOptics
from saltus.terrain.terrain import Terrain

CHUNK = 64
"""Robots that are worked on together: their arrays of 600 kB stay in the processor's cache."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotTrajectory:
    """One robot's motion on one terrain, one row per tick of 10 ms:
    the truth, and proprioception.
    """

    terrain: Terrain
    position_base_in_world: Floats
    """[m], shape (ticks, 3)."""
    quaternion_base_in_world: Floats
    """Shape (ticks, 4)."""
    joint_position: Floats
    """[rad], shape (ticks, 12)."""
    proprioception: Floats
    """From the robot's own estimates, see `saltus.heightmap.service.proprioception_vector`, shape
    (ticks, n)."""


def film_robots(
    trajectories: Sequence[RobotTrajectory],
    views: Sequence[RobotCamera],
    camera: DepthCamera,
    profile: Profile,
    grid: HeightGrid,
    rng: np.random.Generator,
    renderer: str = USUAL_RENDERER,
) -> list[Episode]:
    """Episodes of the motion of robots, with the true heights, and of what their cameras give out.

    Args:
        trajectories: The motion of each robot.
        views: Its camera as it really is, of the model's resolution, or `SAMPLED` for one with
            errors of stereo matching.
        camera: Which one all have.
        profile: What it makes of images, and how long they travel.
        grid: Of the true heights.
        rng: Of the quality of each camera, of its errors and of what effects draw.
        renderer: Name of the back end.
    """
    chain = to_images(profile, MODEL_CAMERA.fx).camera_chain
    parts = [slice(first, first + CHUNK) for first in range(0, len(trajectories), CHUNK)]
    stereo = [_drawn_stereo(camera, len(trajectories[part]), rng) for part in parts]
    memories = [chain.taken.init((), rng) for _ in trajectories]
    episodes: list[Episode] = []
    for part, errors in zip(parts, stereo, strict=True):
        recorded = _Recorded(trajectories[part], views[part], camera, renderer)
        images = recorded.film(
            Eyes(camera, recorded, chain.taken, stack_states(memories[part]), *errors)
        )
        for each, (depth, frame_tick) in zip(trajectories[part], images, strict=True):
            heights = true_heights(
                each.terrain, each.position_base_in_world, each.quaternion_base_in_world, grid
            )
            episodes.append(
                Episode(
                    terrain=each.terrain.kind,
                    proprioception=each.proprioception.astype(np.float32),
                    height=heights.astype(np.float32),
                    depth=depth,
                    frame_tick=frame_tick,
                    latency=chain.latency,
                )
            )
    return episodes


def _drawn_stereo(
    camera: DepthCamera, count: int, rng: np.random.Generator
) -> tuple[StereoCamera | None, StereoState]:
    """The errors of cameras of different quality, and their state; none of ideal ones."""
    if camera.ideal:
        return None, ()
    stereo = StereoCamera(
        drawn_cameras(count, rng, StereoConfig.of(camera)), StereoOptics.behind(SAMPLED, camera)
    )
    return stereo, stereo.init((count,), rng)


class _Recorded:
    """See `saltus.render.eyes.BatchRenderer`: robots are where they were at the numbered exposure.

    The camera of a robot whose run is over stands still; what it takes is not kept.
    """

    def __init__(
        self,
        trajectories: Sequence[RobotTrajectory],
        views: Sequence[RobotCamera],
        camera: DepthCamera,
        renderer: str,
    ) -> None:
        self._ticks = [camera.exposures(len(each.joint_position)) for each in trajectories]
        self._seen: list[tuple[AnyArray, ...]] = []
        """True depth, and for a camera with errors what its second imager does not see, at each
        image."""
        for each, rows, view in zip(trajectories, self._ticks, views, strict=True):
            optics = StereoOptics.behind(view.intrinsics if camera.ideal else SAMPLED, camera)
            # One thread: other processes have the other cores
            pair = make_stereo(renderer, each.terrain, optics, view)
            poses = (
                each.position_base_in_world[rows],
                each.quaternion_base_in_world[rows],
                each.joint_position[rows],
            )
            self._seen.append(
                (pair.render_batch(*poses),) if camera.ideal else pair.render_pair_batch(*poses)
            )

    def depth(self, truth: int) -> Singles:
        return self._of(0, truth)

    def pair(self, truth: int) -> tuple[Singles, NDArray[np.bool_]]:
        return self._of(0, truth), self._of(1, truth)

    def _of(self, kind: int, number: int) -> Any:
        return np.stack([seen[kind][min(number, len(seen[kind]) - 1)] for seen in self._seen])

    def film(self, eyes: Eyes) -> Iterator[tuple[NDArray[np.uint16], NDArray[np.int32]]]:
        """All images of each robot that were not lost [mm],
        and the ticks at which they were taken.
        """
        nobody, ticks = np.zeros(len(self._ticks), np.bool_), max(self._ticks, key=len)
        given = [eyes.expose(i, int(tick), nobody) for i, tick in enumerate(ticks)]
        images = np.stack([each.depth for each in given if each is not None], axis=1)
        there = (
            np.stack([each.time_s for each in given if each is not None], axis=1) == TICK_S * ticks
        )
        for depth, kept, own in zip(images, there, self._ticks, strict=True):
            yield depth[: len(own)][kept[: len(own)]], own[kept[: len(own)]]
