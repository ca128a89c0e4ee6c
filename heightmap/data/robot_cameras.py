"""The cameras of many robots at once in roll-outs: true depth, or with the errors of stereo matching."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saltus.depth import MODEL_CAMERA
from saltus.depth_camera import DepthCamera
from saltus.effects.effect import map_arrays
from saltus.effects.profile import Profile
from saltus.heightmap.data.stereo_images import SAMPLED
from saltus.render.camera import RobotCamera
from saltus.render.embree import EmbreeRenderer
from saltus.render.stereo.camera import StereoCamera, StereoConfig, StereoState
from saltus.render.stereo.model_view import COLUMNS, ROWS, pooled
from saltus.render.stereo.optics import Optics
from saltus.render.stereo_embree import StereoEmbree
from saltus.robots.robot import Robot
from saltus.sim.state import PlantState
from saltus.terrain.stack import TerrainStack


class RobotCameras(Protocol):
    """Takes an image of every robot."""

    camera: DepthCamera
    """Which one they have."""

    def expose(self, truth: PlantState, time_s: float) -> NDArray[np.float32]:
        """Depth [m] that each robot's camera takes now, 0 where invalid, shape (n, 48, 16)."""
        ...


class IdealCameras:
    """True depth of robots on their terrains; the profile moves cameras from where `robot` has them."""

    def __init__(self, camera: DepthCamera, robot: Robot, terrains: TerrainStack, profile: Profile) -> None:
        self.camera, view = camera, RobotCamera.on(robot).moved(profile.view_chain)
        self._count = len(terrains.terrains)
        self._views = [
            (EmbreeRenderer(terrains.terrains[group[0]], view, threads=1), group)
            for group in _robots_by_terrain(terrains)
        ]

    def expose(self, truth: PlantState, time_s: float) -> NDArray[np.float32]:
        """See `RobotCameras`."""
        del time_s  # true depth has no history
        depth = np.empty((self._count, MODEL_CAMERA.height, MODEL_CAMERA.width), np.float32)
        for view, robots in self._views:
            depth[robots] = view.render_batch(
                truth.position_base_in_world[robots], truth.quaternion_base_in_world[robots],
                truth.joint_position[robots],
            )  # fmt: skip
        seen: NDArray[np.float32] = self.camera.for_model(depth)
        return seen


class StereoCameras:
    """Stereo cameras by the fast chain: three rays, one under the other, for the pixels that one of the model averages.

    The profile moves cameras from where `robot` has them; `config`, the errors, may have one value a robot.
    Each robot's noise comes from a generator of its own, so that it does not depend on who else is in the batch.
    """

    def __init__(
        self,
        camera: DepthCamera,
        robot: Robot,
        terrains: TerrainStack,
        profile: Profile,
        config: StereoConfig,
        rngs: Sequence[np.random.Generator],
    ) -> None:
        self.camera, view = camera, RobotCamera.on(robot, SAMPLED).moved(profile.view_chain)
        count, optics = len(terrains.terrains), Optics.behind(SAMPLED, camera)
        self._views = [
            (StereoEmbree(terrains.terrains[group[0]], optics, view), group) for group in _robots_by_terrain(terrains)
        ]
        self._depth = np.empty((count, SAMPLED.height, SAMPLED.width), np.float32)
        self._hidden = np.empty(self._depth.shape, np.bool_)
        self._stereo = StereoCamera(config, optics)
        states = [self._stereo.init((), rng) for rng in rngs]
        self._state: StereoState = map_arrays(lambda *keys: np.stack(keys), *states)

    def expose(self, truth: PlantState, time_s: float) -> NDArray[np.float32]:
        """See `RobotCameras`."""
        for view, robots in self._views:
            self._depth[robots], self._hidden[robots] = view.render_pair_batch(
                truth.position_base_in_world[robots], truth.quaternion_base_in_world[robots],
                truth.joint_position[robots],
            )  # fmt: skip
        times = np.full(len(self._depth), time_s)
        image, self._state = self._stereo.step(self._depth, self._hidden, times, self._state)
        depth: NDArray[np.float32] = self.camera.for_model(pooled(image.depth, ROWS, COLUMNS))
        return depth


def _robots_by_terrain(terrains: TerrainStack) -> list[NDArray[np.int64]]:
    """Robots on the same terrain, for each distinct one: their images are taken together."""
    robots: dict[int, list[int]] = {}
    for i, terrain in enumerate(terrains.terrains):
        robots.setdefault(id(terrain), []).append(i)
    return [np.asarray(group) for group in robots.values()]
