"""What every back end does: poses of the robot to depth images."""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from render.camera import Mount
from saltus.depth import MODEL_CAMERA, Intrinsics
from saltus.messages import Floats
from saltus.terrain.terrain import Terrain


class Renderer(ABC):
    """Depth of one terrain, and of the robot's own legs, seen from the robot's camera.

    Args:
        terrain: what there is to see.
        intrinsics: of the camera.
        mount: of the camera on the trunk; the Go1's where it is not given.
        legs: whether the robot's legs can be seen.
    """

    name: ClassVar[str]

    def __init__(
        self,
        terrain: Terrain,
        intrinsics: Intrinsics = MODEL_CAMERA,
        mount: Mount | None = None,
        *,
        legs: bool = True,
    ) -> None:
        self.terrain = terrain
        self.intrinsics = intrinsics
        self.mount = mount or Mount()
        self.legs = legs

    def render(self, base_position: Floats, base_quaternion: Floats, joint_position: Floats) -> NDArray[np.float32]:
        """Depth along the optical axis [m], infinite where nothing is hit, shape (height, width).

        Args:
            base_position: [m], world frame, shape (3,).
            base_quaternion: (w, x, y, z), base to world, shape (4,).
            joint_position: [rad], shape (12,).
        """
        return self.render_batch(base_position[None], base_quaternion[None], joint_position[None])[0]

    @abstractmethod
    def render_batch(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats
    ) -> NDArray[np.float32]:
        """The same for many poses: arrays of shape (n, ...), images of shape (n, height, width)."""

    def close(self) -> None:
        """Frees what the back end holds; the renderer cannot be used afterwards."""
        return
