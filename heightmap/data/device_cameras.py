"""The cameras of thousands of robots on one device: from poses to images without leaving it."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from saltus.depth import MODEL_CAMERA, depth_in_millimetres, sampled_model_camera
from saltus.depth_camera import DepthCamera
from saltus.effects.camera_latency import CameraLatency
from saltus.effects.effect import map_arrays
from saltus.effects.image_pixels import to_images
from saltus.effects.profile import Profile
from saltus.effects.signals import DepthImage
from saltus.errors import ConfigError
from saltus.heightmap.data.delivery import TICK_S, DeliveryModel
from saltus.heightmap.data.late_images import LateImages
from saltus.heightmap.data.mounts import random_mount
from saltus.render.camera import Mount, RobotCamera
from saltus.render.randomisation import drawn_cameras
from saltus.render.stereo.camera import StereoConfig
from saltus.render.stereo.model_view import COLUMNS, ROWS
from saltus.render.stereo.optics import Optics
from saltus.render.stereo_torch import TorchStereo
from saltus.render.warp import WarpCaster, as_tensor
from saltus.robots.robot import Robot
from saltus.terrain.batch import Courses

_SAMPLED = sampled_model_camera(ROWS, COLUMNS)


class DeviceCameras:
    """Takes images of every robot, each with a camera of its own.

    Cameras are given by name; what is asked for together is taken at the same times, from the same place. What the
    profile says of cameras holds for all, but for their latency: images are as they are given out.

    Raises:
        ConfigError: their places or rates differ.
    """

    def __init__(
        self,
        robot: Robot,
        courses: Courses,
        cameras: Mapping[str, DepthCamera],
        profile: Profile,
        device: str,
        rng: np.random.Generator,
    ) -> None:
        first, *others = cameras.values()
        self._robot, self._count = first.mounted_on(robot), len(courses.finish_x)
        if any(other.rate_hz != first.rate_hz or other.mounted_on(robot) != self._robot for other in others):
            raise ConfigError(f"cameras = {', '.join(cameras)}: rates or places differ; collect for each by itself")
        self._device, self._cameras, self._view = device, cameras, profile.view_chain
        self._chain = to_images(profile, MODEL_CAMERA.fx).camera_chain.taken
        self._fresh = torch.ones(self._count, dtype=torch.bool, device=device)
        self._optics = {name: Optics.behind(_SAMPLED, camera) for name, camera in cameras.items()}
        views = {name: MODEL_CAMERA if camera.ideal else _SAMPLED for name, camera in cameras.items()}
        self._casters = {
            name: WarpCaster(courses.boxes(), RobotCamera.on(self._robot, view).moved(self._view), device=device)
            for name, view in views.items()
        }
        self.replace(rng)

    def replace(self, rng: np.random.Generator) -> None:
        """Gives every robot another camera: place on the trunk, and how large the errors of its images are."""
        claimed = RobotCamera(
            robot=self._robot, intrinsics=MODEL_CAMERA, mount=random_mount(self._robot, rng, self._count)
        )
        for caster in self._casters.values():
            caster.set_mount(claimed.moved(self._view).mount)
        self._stereo = {
            name: TorchStereo(
                drawn_cameras(self._count, rng, StereoConfig.of(camera)), self._optics[name], self._device
            )
            for name, camera in self._cameras.items()
            if not camera.ideal
        }
        self._state = {name: stereo.init(self._count, rng) for name, stereo in self._stereo.items()}
        keys = self._chain.init((self._count,), rng)
        on_device = map_arrays(lambda array: torch.as_tensor(array, device=self._device), keys)
        self._given = dict.fromkeys(self._cameras, on_device)

    @property
    def mounts(self) -> Mount:
        """Where the cameras sit."""
        return next(iter(self._casters.values())).camera.mount

    def expose(self, courses: Courses, qpos: Tensor, tick: int, fresh: Tensor) -> dict[str, DepthImage]:
        """Takes an image of each kind where it is the time.

        Args:
            courses: Of the robots, now.
            qpos: Of the robots, see `saltus.sim.engine.Engine`, float32, shape (n, 19).
            tick: Counted from the first image; to be asked for one by one.
            fresh: Robots that start anew, bool, shape (n,).

        Returns:
            The newest images that were given out [mm], 0 where invalid, `saltus.depth.NOTHING` where nothing is in
            range, int32, shape (n, 48, 16).
        """
        self._fresh |= fresh
        if not next(iter(self._cameras.values())).exposes(tick):
            return {}
        boxes = courses.boxes()
        now_s = torch.full((self._count,), tick * TICK_S, dtype=torch.float64, device=self._device)
        robots = qpos[:, :3], qpos[:, 3:7], qpos[:, 7:]
        images: dict[str, DepthImage] = {}
        for name, caster in self._casters.items():
            caster.set_boxes(boxes)
            if (stereo := self._stereo.get(name)) is None:
                depth = as_tensor(caster.cast(*robots))
            else:
                true, hidden = map(as_tensor, caster.cast_pair(*robots, baseline_m=self._optics[name].baseline_m))
                depth, self._state[name] = stereo.step_pooled(true, hidden, now_s, self._state[name], ROWS, COLUMNS)
            exposed = DepthImage(depth=self._cameras[name].for_model(depth), time_s=now_s)
            given, self._given[name] = self._chain.step(exposed, tick * TICK_S, self._given[name], self._fresh)
            images[name] = replace(given, depth=depth_in_millimetres(given.depth))
        self._fresh = torch.zeros_like(fresh)
        return images


def late_images(
    count: int,
    delivery: DeliveryModel,
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
