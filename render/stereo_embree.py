"""Both views of a stereo camera by rays: depth from the left imager, and a ray from the right one to every point."""

import numpy as np
import open3d
from numpy.typing import NDArray

from render.camera import Mount, camera_pose
from render.capsules import NEAREST, capsule_depth, capsules_in_camera
from render.embree import RAYS_PER_CAST, EmbreeRenderer
from render.legs import Capsules, leg_capsules
from render.stereo.optics import Optics
from saltus.depth import MODEL_CAMERA, Intrinsics
from saltus.messages import Floats
from saltus.terrain.terrain import Terrain

FARTHEST_M = 20.0  # what is farther has a disparity of half a pixel: both imagers see it alike
ALONG_RAY = 0.999  # of the way from the right imager to a point: short of the surface that the point lies on


class StereoEmbree(EmbreeRenderer):
    """An Embree renderer that also says what the right imager of a stereo camera does not see.

    The second view is one ray for each point of the left image, so it is exact at every pixel and has no border.

    Args:
        terrain: see `Renderer`.
        optics: of the pair, for images of `intrinsics`.
        intrinsics: of the left images.
        mount: of the left imager.
        legs: see `Renderer`.
        threads: of the ray caster.
    """

    def __init__(
        self,
        terrain: Terrain,
        optics: Optics,
        intrinsics: Intrinsics = MODEL_CAMERA,
        mount: Mount | None = None,
        *,
        legs: bool = True,
        threads: int = 1,
    ) -> None:
        super().__init__(terrain, intrinsics, mount, legs=legs, threads=threads)
        self.optics = optics

    def render_pair(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """One pair; arguments as `Renderer.render`, results as `render_pair_batch` without its first dimension."""
        depth, hidden = self.render_pair_batch(base_position[None], base_quaternion[None], joint_position[None])
        return depth[0], hidden[0]

    def render_pair_batch(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Depth from the left imager [m] and whether the right one does not see the point.

        Arguments as `Renderer.render_batch`; both results have the shape (n, height, width).
        """
        depth = self.render_batch(base_position, base_quaternion, joint_position)
        hidden = np.empty(depth.shape, dtype=np.bool_)
        chunk = max(1, RAYS_PER_CAST // depth[0].size)
        for first in range(0, len(depth), chunk):
            part = slice(first, first + chunk)
            origin, rotation = camera_pose(self.mount, base_position[part], base_quaternion[part])
            hidden[part] = self._terrain_hides(depth[part], origin, rotation)
        if self.legs:
            right = self.mount.position + self.mount.rotation[:, 0] * self.optics.baseline_m
            legs = capsules_in_camera(leg_capsules(joint_position), right, self.mount.rotation)
            for i in range(len(depth)):
                _hide_behind(hidden[i], depth[i], legs, i, self._directions, self.optics)
        return depth, hidden

    def _terrain_hides(self, depth: NDArray[np.float32], origin: Floats, rotation: Floats) -> NDArray[np.bool_]:
        """Whether terrain lies between the right imager and points, shape (n, height, width)."""
        flat = self._directions.reshape(-1, 3).astype(np.float32)
        along = np.minimum(depth, FARTHEST_M).reshape(len(depth), -1, 1)
        to_right = (rotation[..., 0] * self.optics.baseline_m).astype(np.float32)
        rays = np.empty((len(depth), flat.shape[0], 6), dtype=np.float32)
        rays[..., :3] = (origin + to_right)[:, None, :]
        np.multiply(flat @ rotation.mT.astype(np.float32), along, out=rays[..., 3:])
        rays[..., 3:] -= to_right[:, None, :]
        blocked = self._scene.test_occlusions(
            open3d.core.Tensor.from_numpy(rays), 0.0, ALONG_RAY, self._threads
        ).numpy()
        return np.asarray(blocked).reshape(depth.shape)


def _hide_behind(
    hidden: NDArray[np.bool_],
    depth: NDArray[np.float32],
    legs: Capsules,
    image: int,
    directions: Floats,
    optics: Optics,
) -> None:
    """Marks in place the points of one image that legs hide from the right imager, in whose frame the legs are."""
    shift = optics.baseline_m / depth
    for k, radius in enumerate(legs.radius):
        start, end = legs.start[image, k], legs.end[image, k]
        if max(start[2], end[2]) + radius <= 0.0:
            continue
        rows, columns = _may_hide(start, end, float(radius), directions, shift)
        if not rows.size:
            continue
        rays = directions[rows, columns]
        rays[:, 0] -= shift[rows, columns]
        hit = capsule_depth(start, end, float(radius), rays)
        hidden[rows, columns] |= hit < ALONG_RAY * depth[rows, columns]


def _may_hide(
    start: Floats, end: Floats, radius: float, directions: Floats, shift: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the points whose ray from the right imager passes the box around a capsule's image."""
    ends = np.stack([start, end])
    # of a capsule that reaches behind the imager, what lies in front of it
    depths = np.array([max(ends[:, 2].min() - radius, NEAREST), ends[:, 2].max() + radius])
    low = ((ends[:, :2].min(axis=0) - radius)[:, None] / depths).min(axis=-1)
    high = ((ends[:, :2].max(axis=0) + radius)[:, None] / depths).max(axis=-1)
    tall = directions[:, 0, 1]
    first, last = np.searchsorted(tall, [low[1], high[1]])
    across = directions[first:last, :, 0] - shift[first:last]
    rows, columns = np.nonzero((across >= low[0]) & (across <= high[0]))
    return rows + first, columns
