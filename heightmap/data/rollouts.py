"""Turns the motion of robots into episodes to train on: proprioception, images, and true heights."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus import rotations
from saltus.arrays import Floats, Singles
from saltus.depth import MODEL_CAMERA
from saltus.depth_camera import DepthCamera
from saltus.effects.effect import stacked
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.image_pixels import to_images
from saltus.effects.profile import Profile
from saltus.grid import LINE, HeightGrid
from saltus.heightmap.data.delivery import TICK_S
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.settings import USUAL_RENDERER
from saltus.render.backends import make_stereo
from saltus.render.camera import RobotCamera
from saltus.render.eyes import SAMPLED, Eyes
from saltus.render.randomisation import drawn_cameras
from saltus.render.stereo.camera import StereoCamera, StereoConfig, StereoState
from saltus.render.stereo.optics import Optics
from saltus.terrain.terrain import Terrain

CHUNK = 64
"""Robots that are worked on together: their arrays of 600 kB stay in the processor's cache."""


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


def filmed(
    trajectories: Sequence[Trajectory],
    views: Sequence[RobotCamera],
    camera: DepthCamera,
    profile: Profile,
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
        rng: Of the quality of each camera, of its errors and of what effects draw.
        renderer: Name of the back end.
    """
    chain = to_images(profile, MODEL_CAMERA.fx).camera_chain
    parts = [slice(first, first + CHUNK) for first in range(0, len(trajectories), CHUNK)]
    stereo: list[tuple[StereoCamera | None, StereoState]] = [(None, ())] * len(parts)
    if not camera.ideal:
        counts = [len(trajectories[part]) for part in parts]
        stereo = [_drawn_stereo(camera, count, rng) for count in counts]
    memories = [chain.taken.init((), rng) for _ in trajectories]
    episodes: list[Episode] = []
    for part, errors in zip(parts, stereo, strict=True):
        recorded = _Recorded(trajectories[part], views[part], camera, renderer)
        eyes = Eyes(camera, recorded, chain.taken, stacked(memories[part]), *errors)
        images = recorded.film(eyes)
        for trajectory, given in zip(trajectories[part], images, strict=True):
            episodes.append(_labelled(trajectory, *given, chain.latency))
    return episodes


def _drawn_stereo(camera: DepthCamera, count: int, rng: np.random.Generator) -> tuple[StereoCamera, StereoState]:
    """The errors of cameras of different quality, and their state."""
    optics = Optics.behind(SAMPLED, camera)
    stereo = StereoCamera(drawn_cameras(count, rng, StereoConfig.of(camera)), optics)
    return stereo, stereo.init((count,), rng)


class _Recorded:
    """See `saltus.render.eyes.BatchRenderer`: robots are where they were at the numbered exposure.

    The camera of a robot whose run is over stands still; what it takes is not kept.
    """

    def __init__(
        self,
        trajectories: Sequence[Trajectory],
        views: Sequence[RobotCamera],
        camera: DepthCamera,
        renderer: str,
    ) -> None:
        self._ticks = [camera.exposures(len(each.joint_position)) for each in trajectories]
        self._seen = [
            _rendered(each, rows, view, camera, renderer)
            for each, rows, view in zip(trajectories, self._ticks, views, strict=True)
        ]

    def depth(self, truth: int) -> Singles:
        return self._of(0, truth)

    def pair(self, truth: int) -> tuple[Singles, NDArray[np.bool_]]:
        return self._of(0, truth), self._of(1, truth)

    def _of(self, kind: int, number: int) -> Any:
        return np.stack([seen[kind][min(number, len(seen[kind]) - 1)] for seen in self._seen])

    def film(self, eyes: Eyes) -> list[tuple[NDArray[np.uint16], NDArray[np.int32]]]:
        """All images of each robot that were not lost [mm], and the ticks at which they were taken."""
        count, ticks = len(self._ticks), max(self._ticks, key=len)
        images = np.empty((count, len(ticks), MODEL_CAMERA.height, MODEL_CAMERA.width), np.uint16)
        there = np.empty((count, len(ticks)), np.bool_)
        for i, tick in enumerate(ticks):
            given = eyes.expose(i, int(tick), np.zeros(count, np.bool_))
            assert given is not None  # noqa: S101 - it is the time
            images[:, i], there[:, i] = given.depth, given.time_s == TICK_S * tick
        kept = [there[row, : len(own)] for row, own in enumerate(self._ticks)]
        return [(images[row, : len(own)][kept[row]], own[kept[row]]) for row, own in enumerate(self._ticks)]


def _rendered(
    trajectory: Trajectory,
    rows: NDArray[np.int32],
    view: RobotCamera,
    camera: DepthCamera,
    renderer: str,
) -> tuple[Any, ...]:
    """True depth, and for a camera with errors what its second imager does not see, at each image."""
    optics = Optics.behind(view.intrinsics if camera.ideal else SAMPLED, camera)
    # one thread: other processes have the other cores
    pair = make_stereo(renderer, trajectory.terrain, optics, view)
    poses = (
        trajectory.position_base_in_world[rows],
        trajectory.quaternion_base_in_world[rows],
        trajectory.joint_position[rows],
    )
    return (pair.render_batch(*poses),) if camera.ideal else pair.render_pair_batch(*poses)


def _labelled(
    trajectory: Trajectory,
    depth: NDArray[np.uint16],
    frame_tick: NDArray[np.int32],
    latency: CameraLatency,
) -> Episode:
    position, quaternion = trajectory.position_base_in_world, trajectory.quaternion_base_in_world
    return Episode(
        terrain=trajectory.terrain.kind,
        proprioception=trajectory.proprioception.astype(np.float32),
        height=true_heights(trajectory.terrain, position, quaternion).astype(np.float32),
        depth=depth,
        frame_tick=frame_tick,
        latency=latency,
    )
