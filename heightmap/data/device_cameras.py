"""The cameras of thousands of robots on one device: from poses to images without leaving it."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from saltus.config import Camera
from saltus.depth import MILLIMETRE, NOTHING
from saltus.heightmap.data.delivery import TICK_S
from saltus.heightmap.data.mounts import random_mount
from saltus.render.camera import Mount, RobotCamera
from saltus.render.randomisation import drawn_cameras
from saltus.render.stereo.model_view import COLUMNS, ROWS, sampled_model_camera
from saltus.render.stereo.optics import Optics
from saltus.render.stereo_torch import TorchStereo
from saltus.render.warp import WarpCaster, as_tensor
from saltus.robots.robot import Robot
from saltus.terrain.batch import Courses

_SAMPLED = sampled_model_camera(ROWS, COLUMNS)
_OPTICS = Optics.of(_SAMPLED)


class DeviceCameras:
    """Takes images of every robot, each with a camera of its own.

    Images of several kinds (ideal: true depth; d435i: with the errors of stereo matching) are taken from the same
    place.
    """

    def __init__(
        self, robot: Robot, courses: Courses, kinds: Sequence[Camera], device: str, rng: np.random.Generator
    ) -> None:
        self._robot, self._count = robot, len(courses.finish_x)
        self._device = device
        views = {"ideal": RobotCamera.on(robot), "d435i": RobotCamera.on(robot, _SAMPLED)}
        self._casters = {kind: WarpCaster(courses.boxes(), views[kind], device=device) for kind in kinds}
        self.replace(rng)

    def replace(self, rng: np.random.Generator) -> None:
        """Gives every robot another camera: place on the trunk, and how large the errors of its images are."""
        mounts = random_mount(self._robot, rng, self._count)
        for caster in self._casters.values():
            caster.set_mount(mounts)
        self._stereo = TorchStereo(drawn_cameras(self._count, rng), _OPTICS, self._device)
        self._state = self._stereo.init(self._count, rng)

    @property
    def mounts(self) -> Mount:
        """Where the cameras sit."""
        return next(iter(self._casters.values())).camera.mount

    def expose(self, courses: Courses, qpos: Tensor, tick: int) -> dict[Camera, Tensor]:
        """Takes an image of each kind.

        `qpos` is as in `saltus.sim.engine.Engine`, shape (n, 19). Images are in mm, 0 where invalid,
        `saltus.depth.NOTHING` where nothing is in range, int32, shape (n, 48, 16).
        """
        boxes = courses.boxes()
        robots = qpos[:, :3], qpos[:, 3:7], qpos[:, 7:]
        images: dict[Camera, Tensor] = {}
        for kind, caster in self._casters.items():
            caster.set_boxes(boxes)
            if kind == "ideal":
                depth = as_tensor(caster.cast(*robots))
            else:
                time_s = torch.full((self._count,), tick * TICK_S, dtype=torch.float64, device=self._device)
                true, hidden = map(as_tensor, caster.cast_pair(*robots, baseline_m=_OPTICS.baseline_m))
                depth, self._state = self._stereo.step_pooled(true, hidden, time_s, self._state, ROWS, COLUMNS)
            images[kind] = _in_millimetres(depth)
        return images


def _in_millimetres(depth: Tensor) -> Tensor:
    """The law of `saltus.depth.depth_in_millimetres`."""
    return (depth.clamp(max=NOTHING * MILLIMETRE) * (1.0 / MILLIMETRE)).round().to(torch.int32)
