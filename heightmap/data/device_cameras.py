"""The cameras of thousands of robots on one device: from poses to images without leaving it."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from saltus.depth import MODEL_CAMERA
from saltus.depth_camera import DepthCamera
from saltus.effects.effect import State, map_arrays
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.image_pixels import to_images
from saltus.effects.profile import Profile
from saltus.effects.signals import DepthImage
from saltus.errors import ConfigError
from saltus.heightmap.data.arriving_images import LateImages
from saltus.heightmap.data.delivery import ImageDeliveryModel
from saltus.heightmap.data.randomisation import random_mount
from saltus.render.camera import RobotCamera
from saltus.render.eyes import SAMPLED, Eyes
from saltus.render.randomisation import drawn_cameras
from saltus.render.stereo.camera import StereoCamera, StereoConfig
from saltus.render.stereo.optics import StereoOptics
from saltus.render.stereo_torch import KorniaWindows
from saltus.render.warp import WarpCaster, as_tensor
from saltus.robots.robot import Robot
from saltus.terrain.course_batch import CourseBatch


class DeviceCameras:
    """Takes images of every robot, each with a camera of its own.

    Cameras are given by name; what is asked for together is taken at the same times, from the same
    place. What the profile says of cameras holds for all, but for their latency: images are as they
    are given out.

    Raises:
        ConfigError: their places or rates differ.
    """

    def __init__(
        self,
        robot: Robot,
        courses: CourseBatch,
        cameras: Mapping[str, DepthCamera],
        profile: Profile,
        device: str,
        rng: np.random.Generator,
    ) -> None:
        first, *others = cameras.values()
        self._robot, self._count = first.mounted_on(robot), len(courses.finish_x)
        if any(
            other.rate_hz != first.rate_hz or other.mounted_on(robot) != self._robot
            for other in others
        ):
            raise ConfigError(
                f"cameras = {', '.join(cameras)}: rates or places differ; collect for each by "
                "itself"
            )
        self._device, self._kinds, self._view = device, cameras, profile.view_chain
        self._chain = to_images(profile, MODEL_CAMERA.fx).camera_chain.taken
        self._views = {
            name: _WarpBatch(
                courses,
                RobotCamera.on(self._robot, MODEL_CAMERA if kind.ideal else SAMPLED).moved(
                    self._view
                ),
                StereoOptics.behind(SAMPLED, kind),
                device,
            )
            for name, kind in cameras.items()
        }
        self.replace(rng)

    def replace(self, rng: np.random.Generator) -> None:
        """Gives every robot another camera: place on the trunk,
        and how large the errors of its images are.
        """
        count, mount = self._count, random_mount(self._robot, rng, self._count)
        claimed = RobotCamera(robot=self._robot, intrinsics=MODEL_CAMERA, mount=mount)
        for view in self._views.values():
            view.caster.set_mount(claimed.moved(self._view).mount)
        stereo = {
            name: StereoCamera(
                drawn_cameras(count, rng, StereoConfig.of(kind)),
                self._views[name].optics,
                KorniaWindows(),
            )
            for name, kind in self._kinds.items()
            if not kind.ideal
        }
        states = {name: self._tensors(each.init((count,), rng)) for name, each in stereo.items()}
        memory = self._tensors(self._chain.init((count,), rng))
        self._eyes = {
            name: Eyes(
                kind, self._views[name], self._chain, memory, stereo.get(name), states.get(name, ())
            )
            for name, kind in self._kinds.items()
        }

    def expose(
        self, courses: CourseBatch, qpos: Tensor, tick: int, fresh: Tensor
    ) -> dict[str, DepthImage]:
        """Takes an image of each kind where it is the time.

        Args:
            courses: Of the robots, now.
            qpos: Of the robots, see `saltus.sim.engine.Engine`, float32, shape (n, 19).
            tick: Counted from the first image; to be asked for one by one.
            fresh: Robots that start anew, bool, shape (n,).

        Returns:
            The newest images that were given out [mm], int32, shape (n, 48, 16).
        """
        given = {
            name: eyes.expose((courses, qpos), tick, fresh) for name, eyes in self._eyes.items()
        }
        return {name: image for name, image in given.items() if image is not None}

    def _tensors(self, state: State) -> State:
        return map_arrays(lambda array: torch.as_tensor(array, device=self._device), state)


class _WarpBatch:
    """See `saltus.render.eyes.BatchRenderer`; robots are where courses and `qpos` say."""

    def __init__(
        self, courses: CourseBatch, camera: RobotCamera, optics: StereoOptics, device: str
    ) -> None:
        self.caster, self.optics = WarpCaster(courses.boxes(), camera, device=device), optics

    def depth(self, truth: tuple[CourseBatch, Tensor]) -> Tensor:
        depth: Tensor = as_tensor(self.caster.cast(*self._poses(*truth)))
        return depth

    def pair(self, truth: tuple[CourseBatch, Tensor]) -> tuple[Tensor, Tensor]:
        depth, hidden = self.caster.cast_pair(
            *self._poses(*truth), baseline_m=self.optics.baseline_m
        )
        return as_tensor(depth), as_tensor(hidden)

    def _poses(self, courses: CourseBatch, qpos: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        self.caster.set_boxes(courses.boxes())
        return qpos[:, :3], qpos[:, 3:7], qpos[:, 7:]


def late_images(
    count: int,
    delivery: ImageDeliveryModel,
    latency: CameraLatency,
    rng: np.random.Generator,
    device: torch.device | str,
) -> LateImages:
    """The images [mm] of `count` cameras that have a latency, delivered without pauses."""
    chain = delivery.drawn(latency, (count,), rng)
    state = map_arrays(lambda keys: torch.as_tensor(keys, device=device), chain.init((count,), rng))
    time_s = torch.zeros(count, dtype=torch.float64, device=device)
    shape = count, MODEL_CAMERA.height, MODEL_CAMERA.width
    depth = torch.zeros(shape, dtype=torch.int32, device=device)
    return LateImages(chain, state, DepthImage(depth=depth, time_s=time_s))
