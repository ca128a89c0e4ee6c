"""Back end on Embree (open3d): rays against the terrain's triangles, exact capsules for the legs."""

from typing import ClassVar

import numpy as np
import open3d
from numpy.typing import NDArray

from render.boxes import box_triangles
from render.camera import Mount, camera_pose, ray_directions
from render.capsules import capsules_in_camera, draw_capsules
from render.legs import leg_capsules
from render.renderer import Renderer
from saltus.depth import MODEL_CAMERA, Intrinsics
from saltus.messages import Floats
from saltus.terrain.terrain import Terrain

RAYS_PER_CAST = 1_000_000  # 24 MB of rays: bounds memory, far beyond the cost of a call


class EmbreeRenderer(Renderer):
    """See `Renderer`. Takes many poses in one call.

    Args:
        threads: for casting rays; one is fastest for single small images.
    """

    name: ClassVar[str] = "embree"

    def __init__(
        self,
        terrain: Terrain,
        intrinsics: Intrinsics = MODEL_CAMERA,
        mount: Mount | None = None,
        *,
        legs: bool = True,
        threads: int = 1,
    ) -> None:
        super().__init__(terrain, intrinsics, mount, legs=legs)
        vertices, triangles = box_triangles(terrain)
        self._threads = threads
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=threads)
        self._scene.add_triangles(open3d.core.Tensor.from_numpy(vertices), open3d.core.Tensor.from_numpy(triangles))
        self._directions = ray_directions(intrinsics)

    def render_batch(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats
    ) -> NDArray[np.float32]:
        """See `Renderer`."""
        height, width = self.intrinsics.height, self.intrinsics.width
        depth = np.empty((len(base_position), height, width), dtype=np.float32)
        chunk = max(1, RAYS_PER_CAST // (height * width))
        for first in range(0, len(depth), chunk):
            part = slice(first, first + chunk)
            origin, rotation = camera_pose(self.mount, base_position[part], base_quaternion[part])
            depth[part] = self._cast(origin, rotation)
        if self.legs:
            legs = capsules_in_camera(leg_capsules(joint_position), self.mount.position, self.mount.rotation)
            draw_capsules(depth, legs, self._directions, self.intrinsics)
        return depth

    def _cast(self, origin: Floats, rotation: Floats) -> NDArray[np.float32]:
        """Depth of the terrain from n camera poses, shape (n, height, width)."""
        flat = self._directions.reshape(-1, 3)
        rays = np.empty((len(origin), len(flat), 6), dtype=np.float32)
        rays[..., :3] = origin[:, None, :]
        rays[..., 3:] = flat @ rotation.mT
        hit = self._scene.cast_rays(open3d.core.Tensor.from_numpy(rays), nthreads=self._threads)["t_hit"].numpy()
        return hit.reshape(len(origin), *self._directions.shape[:2])
