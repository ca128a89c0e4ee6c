"""Renderers, which every back end has: poses of the robot to depth images,
of one imager or of a pair.
"""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.errors import SaltusError
from saltus.render.camera import RobotCamera
from saltus.render.stereo.optics import StereoOptics
from saltus.robots.leg_shapes import LegShapes
from saltus.terrain.terrain import Terrain


class Renderer(ABC):
    """Depth of one terrain, and of the robot's own legs, seen from the robot's camera."""

    name: ClassVar[str]

    def __init__(self, terrain: Terrain, camera: RobotCamera) -> None:
        self.terrain, self.camera = terrain, camera
        self.intrinsics, self.mount = camera.intrinsics, camera.mount
        self.legs = LegShapes(camera.robot)

    def render(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats
    ) -> NDArray[np.float32]:
        """Depth along the optical axis [m], infinite where nothing is hit, shape (height, width).

        Args:
            base_position: [m], world frame, shape (3,).
            base_quaternion: (w, x, y, z), base to world, shape (4,).
            joint_position: [rad], shape (12,).
        """
        return self.render_batch(base_position[None], base_quaternion[None], joint_position[None])[
            0
        ]

    def render_batch(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats
    ) -> NDArray[np.float32]:
        """Depth from many poses, as `render`: arrays of shape (n, ...), images of shape
        (n, height, width).

        Raises:
            SaltusError: a pose is not finite or has another shape.
        """
        check_poses(base_position, base_quaternion, joint_position)
        return self._render(base_position, base_quaternion, joint_position)

    @abstractmethod
    def _render(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats
    ) -> NDArray[np.float32]:
        """Renders as `render_batch` does, poses that have been checked."""


class StereoRenderer(Renderer):
    """Both views of a stereo camera: depth from the left imager,
    and what the right one does not see of it.

    The camera is the left imager; the right one is `optics.baseline_m` to its right.
    """

    optics: StereoOptics

    def render_pair(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Depth from the left imager, and pixels that the right one does not see, of one pose.

        Arguments as `Renderer.render`, results as `render_pair_batch` without its first dimension.
        """
        depth, hidden = self.render_pair_batch(
            base_position[None], base_quaternion[None], joint_position[None]
        )
        return depth[0], hidden[0]

    @abstractmethod
    def render_pair_batch(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Depth from the left imager [m] and whether the right one does not see the point.

        Arguments and errors as those of `Renderer.render_batch`; both results have the shape (n,
        height, width).
        """


def check_poses(base_position: Floats, base_quaternion: Floats, joint_position: Floats) -> None:
    """Refuses poses that are no poses.

    Raises:
        SaltusError: an array has another shape than (n, 3), (n, 4), (n, 12), or holds a number that
            is not finite.
    """
    count = len(base_position)
    given = {"base_position": (base_position, 3), "base_quaternion": (base_quaternion, 4)}
    for name, (value, size) in {**given, "joint_position": (joint_position, 12)}.items():
        if value.shape != (count, size):
            raise SaltusError(
                f"{name} has the shape {tuple(value.shape)}: it must be ({count}, {size})"
            )
        if not np.isfinite(value).all():
            pose = int(np.flatnonzero(~np.isfinite(value).all(axis=-1))[0])
            raise SaltusError(
                f"{name} of pose {pose} is {value[pose].tolist()}: every number must be finite"
            )
