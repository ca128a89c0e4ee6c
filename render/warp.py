"""Back end on Warp: ray casts on a GPU, for thousands of robots at once,
with no copy to or from torch.
"""

from contextlib import AbstractContextManager
from dataclasses import replace
from typing import ClassVar

import numpy as np
import warp
from numpy.typing import NDArray

from saltus.arrays import Array, Floats
from saltus.errors import SaltusError
from saltus.render.camera import RobotCamera, camera_pose
from saltus.render.capsules import capsules_in_camera
from saltus.render.renderer import Renderer, StereoRenderer, check_poses
from saltus.render.stereo.optics import StereoOptics
from saltus.render.warp_kernels import WarpScene, cast_kernel, hide_kernel
from saltus.robots.leg_shapes import LegShapes
from saltus.robots.mount import Mount
from saltus.terrain.boxes import Boxes
from saltus.terrain.terrain import Terrain
from saltus.terrain.terrain_stack import TerrainStack

FARTHEST_M = 20.0  # what is farther has a disparity of half a pixel: both imagers see it alike
# Of the way from the right imager to a point: short of the surface that the point lies on
ALONG_RAY = 0.999


class WarpCaster:
    """Casts the rays of many cameras, each over boxes of its own or all over the same.

    Torch tensors on the device are read where they are, in the order of torch's present stream;
    results are Warp arrays, which `warp.to_torch` turns into tensors without a copy. Boxes are
    arrays of shape (n, boxes, ...), or (1, boxes, ...) for one terrain under all. The device is
    "cuda:0" or "cpu"; by default the first GPU, if any.
    """

    def __init__(self, boxes: Boxes, camera: RobotCamera, *, device: str | None = None) -> None:
        self.camera = camera
        self._legs = LegShapes(camera.robot)
        warp.config.log_level = warp.LOG_WARNING  # no banner
        self.device = str(warp.get_device(device))
        self._radius = warp.array(
            self._legs.radius if camera.legs else [], dtype=float, device=self.device
        )
        self._level = warp.zeros((0, 0), dtype=warp.mat33f, device=self.device)
        self.set_boxes(boxes)

    def set_boxes(self, boxes: Boxes) -> None:
        """Puts other boxes under the robots; arguments as those of the class.

        Raises:
            SaltusError: centres and sizes have different shapes, or they are no boxes.
        """
        center, half_size = boxes.center, boxes.half_size
        if (
            center.ndim != 3
            or center.shape[-1] != 3
            or tuple(center.shape) != tuple(half_size.shape)
        ):
            raise SaltusError(
                f"boxes have centres of shape {tuple(center.shape)} and half sizes of shape "
                f"{tuple(half_size.shape)}: "
                "both must be (robots, boxes, 3)"
            )
        self._low = self._on_device(center - half_size, warp.vec3f)
        self._high = self._on_device(center + half_size, warp.vec3f)
        self._turn = (
            self._level if boxes.turn is None else self._on_device(boxes.rotation, warp.mat33f)
        )

    def set_mount(self, mount: Mount) -> None:
        """Puts the cameras somewhere else on the trunks.

        Raises:
            SaltusError: a number is not finite, or a camera would be in its trunk.
        """
        self.camera = replace(self.camera, mount=mount)

    def cast(
        self, base_position: Array, base_quaternion: Array, joint_position: Array
    ) -> warp.array:
        """Depth along the optical axis [m], infinite where nothing is hit,
        float32, shape (n, height, width).

        Args:
            base_position: [m], world frame, numpy or torch, shape (n, 3).
            base_quaternion: (w, x, y, z), base to world, shape (n, 4).
            joint_position: [rad], shape (n, 12).

        Raises:
            SaltusError: there are boxes for another number of robots.
        """
        with self._stream_of(base_position):
            return self._cast(self._scene(base_position, base_quaternion, joint_position))

    def cast_pair(
        self,
        base_position: Array,
        base_quaternion: Array,
        joint_position: Array,
        *,
        baseline_m: float,
    ) -> tuple[warp.array, warp.array]:
        """Depth as from `cast`, and whether an imager `baseline_m`
        to the right does not see the point.
        """
        with self._stream_of(base_position):
            scene = self._scene(base_position, base_quaternion, joint_position)
            depth = self._cast(scene)
            hidden = warp.empty(depth.shape, dtype=warp.bool, device=self.device)
            warp.launch(
                hide_kernel,
                dim=depth.shape,
                inputs=[scene, depth, baseline_m, FARTHEST_M, ALONG_RAY],
                outputs=[hidden],
                device=self.device,
            )
            return depth, hidden

    def _cast(self, scene: WarpScene) -> warp.array:
        intrinsics = self.camera.intrinsics
        shape = (scene.origin.shape[0], intrinsics.height, intrinsics.width)
        depth = warp.empty(shape, dtype=float, device=self.device)
        warp.launch(cast_kernel, dim=shape, inputs=[scene], outputs=[depth], device=self.device)
        return depth

    def _scene(
        self, base_position: Array, base_quaternion: Array, joint_position: Array
    ) -> WarpScene:
        """Returns what the kernels get."""
        if self._low.shape[0] not in (1, len(base_position)):
            raise SaltusError(
                f"boxes are given for {self._low.shape[0]} robots, poses for {len(base_position)}"
            )
        origin, rotation = camera_pose(self.camera.mount, base_position, base_quaternion)
        legs = self._legs.capsules(joint_position)
        position_in_base, camera_in_base = (
            constant.like(legs.start) for constant in self.camera.mount.in_base
        )
        seen = capsules_in_camera(legs, position_in_base, camera_in_base)
        camera, scene = self.camera.intrinsics, WarpScene()
        scene.origin, scene.rotation = (
            self._on_device(origin, warp.vec3f),
            self._on_device(rotation, warp.mat33f),
        )
        scene.low, scene.high, scene.turn = self._low, self._high, self._turn
        scene.start, scene.end = (
            self._on_device(seen.start, warp.vec3f),
            self._on_device(seen.end, warp.vec3f),
        )
        scene.radius = self._radius
        scene.fx, scene.fy, scene.cx, scene.cy = camera.fx, camera.fy, camera.cx, camera.cy
        return scene

    def _on_device(self, array: Array, dtype: type) -> warp.array:
        if isinstance(array, np.ndarray):
            return warp.array(array.astype(np.float32), dtype=dtype, device=self.device)
        return warp.from_torch(array.float().contiguous(), dtype=dtype)

    def _stream_of(self, array: Array) -> AbstractContextManager[object]:
        """Torch's present stream for its tensors on a GPU, else Warp's own."""
        on_gpu = not isinstance(array, np.ndarray) and array.is_cuda
        return warp.ScopedStream(warp.stream_from_torch(array.device) if on_gpu else None)


def as_tensor(array: warp.array) -> Array:
    """A torch tensor on the memory of a Warp array."""
    return warp.to_torch(array)


class WarpRenderer(Renderer):
    """Renders depth on a GPU with Warp; `caster` does the same without leaving the device. See
    `Renderer`.
    """

    name: ClassVar[str] = "warp"

    def __init__(self, terrain: Terrain, camera: RobotCamera, *, device: str | None = None) -> None:
        super().__init__(terrain, camera)
        boxes = TerrainStack([terrain]).boxes(len(terrain.boxes))
        self.caster = WarpCaster(boxes, camera, device=device)

    def _render(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats
    ) -> NDArray[np.float32]:
        depth: NDArray[np.float32] = self.caster.cast(
            base_position, base_quaternion, joint_position
        ).numpy()
        return depth


class StereoWarp(WarpRenderer, StereoRenderer):
    """Both views of a stereo camera by Warp: a ray from the right imager to every point. See
    `StereoRenderer`.
    """

    def __init__(self, terrain: Terrain, optics: StereoOptics, camera: RobotCamera) -> None:
        super().__init__(terrain, camera)
        self.optics = optics

    def render_pair_batch(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """See `StereoRenderer`."""
        check_poses(base_position, base_quaternion, joint_position)
        depth, hidden = self.caster.cast_pair(
            base_position, base_quaternion, joint_position, baseline_m=self.optics.baseline_m
        )
        return depth.numpy(), hidden.numpy()
