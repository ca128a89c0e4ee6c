"""Back end on Embree (open3d): rays against the terrain's triangles,
exact capsules for the legs.

A course of columns needs no rays where the camera is above it (`saltus.render.course_columns`).
"""

import os
import threading
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.render._open3d import load_open3d
from saltus.render.camera import RobotCamera, camera_pose, ray_directions
from saltus.render.capsules import capsules_in_camera, draw_capsules
from saltus.render.course_columns import SeenColumns
from saltus.render.renderer import Renderer
from saltus.render.terrain_mesh import terrain_triangles
from saltus.robots.leg_shapes import Capsules
from saltus.terrain.terrain import Terrain

open3d = load_open3d()

# 256 images of the model's camera: 4.7 MB of rays, which stay in the cache between writing and
# casting them, while the threads of a call have enough to do
RAYS_PER_CAST = 200_000
RAYS_PER_THREAD = (
    10_000  # half a millisecond of work: below, waking a thread costs more than it brings
)


class EmbreeRenderer(Renderer):
    """Renders depth by casting rays on the CPU with Embree; many poses in one call. See `Renderer`.

    Args:
        threads: for casting the rays of a batch; as many as this process has cores where it is not
            given. Single small images are cast by one. Images do not depend on it. Several threads
            may call one renderer.
    """

    name: ClassVar[str] = "embree"

    def __init__(
        self, terrain: Terrain, camera: RobotCamera, *, threads: int | None = None
    ) -> None:
        super().__init__(terrain, camera)
        vertices, triangles = terrain_triangles(terrain)
        self._threads = threads or len(os.sched_getaffinity(0))
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=self._threads)
        self._scene.add_triangles(
            open3d.core.Tensor.from_numpy(vertices), open3d.core.Tensor.from_numpy(triangles)
        )
        columns = terrain.columns
        self._course = None if columns is None else SeenColumns(columns, self.intrinsics)
        self._directions = ray_directions(self.intrinsics)
        self._across = self._directions[0, :, 0].astype(np.float32)
        self._down = self._directions[:, 0, 1].astype(np.float32)
        self._kept = threading.local()

    def _render(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats
    ) -> NDArray[np.float32]:
        return self._seen(
            *camera_pose(self.mount, base_position, base_quaternion), self._legs(joint_position)
        )

    def _legs(self, joint_position: Floats) -> Capsules | None:
        """Legs in the base frame; None where the camera sees none."""
        return self.legs.capsules(joint_position) if self.camera.legs else None

    def _seen(self, origin: Floats, rotation: Floats, legs: Capsules | None) -> NDArray[np.float32]:
        """Depth of terrain and legs from n camera poses, shape (n, height, width)."""
        height, width = self.intrinsics.height, self.intrinsics.width
        depth = np.empty((len(origin), height, width), dtype=np.float32)
        chunk = max(1, RAYS_PER_CAST // (height * width))
        for first in range(0, len(depth), chunk):
            part = slice(first, first + chunk)
            depth[part] = self._cast(origin[part], rotation[part])
        if legs is not None:
            legs = capsules_in_camera(legs, self.mount.position, self.mount.rotation)
            draw_capsules(depth, legs, self._directions, self.intrinsics)
        return depth

    def _cast(self, origin: Floats, rotation: Floats) -> NDArray[np.float32]:
        """Depth of the terrain from n camera poses, shape (n, height, width)."""
        if self._course is None:
            return self._hit(origin, rotation)
        seen = self._course.sees(origin, rotation)
        if seen.all():
            return self._course.depth(origin, rotation)
        depth = np.empty((len(origin), *self._directions.shape[:2]), dtype=np.float32)
        depth[~seen] = self._hit(origin[~seen], rotation[~seen])
        if seen.any():
            depth[seen] = self._course.depth(origin[seen], rotation[seen])
        return depth

    def _hit(self, origin: Floats, rotation: Floats) -> NDArray[np.float32]:
        """Depth by rays [m]."""
        rays = self._buffer(len(origin))
        rays[..., :3] = origin[:, None, None, :]
        self._turn(rotation.astype(np.float32), rays[..., 3:])
        threads = min(self._threads, 1 + rays.size // (6 * RAYS_PER_THREAD))
        return self._scene.cast_rays(open3d.core.Tensor.from_numpy(rays), nthreads=threads)[
            "t_hit"
        ].numpy()

    def _buffer(self, count: int) -> NDArray[np.float32]:
        """Room for the rays of `count` images, kept from call to call of a thread:
        fresh pages are slow.
        """
        rays: NDArray[np.float32] | None = getattr(self._kept, "rays", None)
        if rays is None or len(rays) < count:
            rays = self._kept.rays = np.empty(
                (count, *self._directions.shape[:2], 6), dtype=np.float32
            )
        return rays[:count]

    def _turn(self, rotation: NDArray[np.float32], out: NDArray[np.float32]) -> None:
        """Directions of pixels in the world:
        what the column gives and what the row gives, one sum for each number.
        """
        for axis in range(3):
            across = rotation[:, axis, :1] * self._across
            down = rotation[:, axis, 1:2] * self._down + rotation[:, axis, 2:]
            np.add(down[:, :, None], across[:, None, :], out=out[..., axis])
