"""Both views of a stereo camera by rays: depth from the left imager,
and a ray from the right one to every point.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.depth import Intrinsics
from saltus.render.camera import RobotCamera, camera_pose
from saltus.render.capsules import Quadrics, capsules_in_camera, windows
from saltus.render.embree import RAYS_PER_CAST, EmbreeRenderer, open3d
from saltus.render.renderer import StereoRenderer, check_poses
from saltus.render.stereo.doubt import doubtful
from saltus.render.stereo.optics import Optics
from saltus.robots.leg_shapes import Capsules
from saltus.terrain.terrain import Terrain

FARTHEST_M = 20.0  # what is farther has a disparity of half a pixel: both imagers see it alike
NEAREST_POINT_M = 0.02  # nothing that a leg could hide comes nearer
# Of the way from the right imager to a point: short of the surface that the point lies on
ALONG_RAY = 0.999


class StereoEmbree(EmbreeRenderer, StereoRenderer):
    """See `StereoRenderer`.

    The second view is one ray for each point of the left image, so it is exact at every pixel and
    has no border; rays that cannot hit terrain are not cast.
    """

    def __init__(
        self, terrain: Terrain, optics: Optics, camera: RobotCamera, *, threads: int = 1
    ) -> None:
        super().__init__(terrain, camera, threads=threads)
        self.optics = optics

    def render_pair_batch(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """See `StereoRenderer`."""
        check_poses(base_position, base_quaternion, joint_position)
        origin, rotation = camera_pose(self.mount, base_position, base_quaternion)
        legs = self._legs(joint_position)
        depth = self._seen(origin, rotation, legs)
        hidden = np.zeros(depth.shape, dtype=np.bool_)
        if legs is not None:
            to_right = self.mount.rotation[:, 0] * self.optics.baseline_m
            legs = capsules_in_camera(legs, self.mount.position + to_right, self.mount.rotation)
        chunk = max(1, RAYS_PER_CAST // depth[0].size)
        for first in range(0, len(depth), chunk):
            part = slice(first, first + chunk)
            near = np.minimum(depth[part], FARTHEST_M)
            self._terrain_hides(hidden[part], near, origin[part], rotation[part])
            if legs is not None:
                own = replace(legs, start=legs.start[part], end=legs.end[part])
                self._legs_hide(hidden[part], depth[part], own)
        return depth, hidden

    def _terrain_hides(
        self,
        hidden: NDArray[np.bool_],
        depth: NDArray[np.float32],
        origin: Floats,
        rotation: Floats,
    ) -> None:
        """Marks in place the points, shape (n, height, width),
        with terrain between them and the right imager.
        """
        baseline_m = self.optics.baseline_m
        point = doubtful(self.terrain, self.intrinsics, origin, rotation, baseline_m, depth)
        if not point.size:
            return
        row, column = np.divmod(point, self.intrinsics.width)
        image, row = np.divmod(row, self.intrinsics.height)
        along, to_right = depth.reshape(-1)[point], baseline_m * rotation[..., 0]
        turn = rotation.astype(np.float32)
        rays = np.empty((len(point), 6), dtype=np.float32)
        rays[:, :3] = (origin + to_right).astype(np.float32)[image]
        for axis in range(3):
            direction = (turn[:, axis, 1:2] * self._down + turn[:, axis, 2:])[image, row]
            direction += (turn[:, axis, :1] * self._across)[image, column]
            direction *= along
            np.subtract(
                direction, to_right[:, axis].astype(np.float32)[image], out=rays[:, 3 + axis]
            )
        blocked = self._scene.test_occlusions(
            open3d.core.Tensor.from_numpy(rays), 0.0, ALONG_RAY, self._threads
        )
        hidden.reshape(-1)[point] = blocked.numpy()

    def _legs_hide(
        self, hidden: NDArray[np.bool_], depth: NDArray[np.float32], legs: Capsules
    ) -> None:
        """Marks in place the points, shape (n, height, width),
        that legs hide from the right imager, their frame.

        Only points whose image in the right imager lies in the window of a leg are tested.
        """
        camera = self.intrinsics
        wide = right_camera(camera, self.optics, NEAREST_POINT_M)
        rows, columns, seen = windows(legs, wide)
        image, k = np.nonzero(seen)
        tall = rows[image, k, 1] - rows[image, k, 0]
        # one line for each row of each window: its window, its row, and its place among all rows of
        # all images
        window = np.repeat(np.arange(len(k)), tall)
        row = np.arange(len(window)) + np.repeat(rows[image, k, 0] - np.cumsum(tall) + tall, tall)
        line = image[window] * camera.height + row
        to_right = np.arange(camera.width, dtype=np.float32) + np.float32(
            wide.width - camera.width + 0.5
        )
        shift = (self.optics.baseline_m / depth).reshape(-1, camera.width)
        place = np.take(to_right - shift * camera.fx, line, axis=0)
        limits = columns[image, k].astype(np.float32)[window]
        found = np.flatnonzero((place >= limits[:, :1]) & (place <= limits[:, 1:]))
        which, column = found // camera.width, found % camera.width
        point = line[which] * camera.width + column
        x = self._directions[0, column, 0] - shift.reshape(-1)[point]
        y = self._directions[row[which], 0, 1]
        quadrics = Quadrics.of(legs.start[image, k], legs.end[image, k], legs.radius[k])
        hit = quadrics.take(window[which]).depth(x, y)
        behind = hit < ALONG_RAY * depth.reshape(-1)[point]
        hidden.reshape(-1)[point[behind]] = True


def right_camera(camera: Intrinsics, optics: Optics, nearest_m: float) -> Intrinsics:
    """A camera at the right imager that sees all that `camera`,
    at the left one, sees from `nearest_m` on.

    It is wider to the left by the largest disparity; what lies outside it counts as visible.
    """
    extra = int(np.ceil(optics.disparity_at_1m / nearest_m / optics.pitch_x))
    return replace(camera, width=camera.width + extra, cx=camera.cx + extra)
