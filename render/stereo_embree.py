"""Both views of a stereo camera by rays: depth from the left imager,
and a ray from the right one to every point.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.depth import Intrinsics
from saltus.render.camera import RobotCamera, camera_pose
from saltus.render.capsules import Quadrics, capsule_windows, capsules_in_camera
from saltus.render.embree import RAYS_PER_CAST, EmbreeRenderer, open3d
from saltus.render.renderer import StereoRenderer, check_poses
from saltus.render.stereo.optics import StereoOptics
from saltus.robots.leg_shapes import Capsules
from saltus.terrain.columns import Columns
from saltus.terrain.terrain import Terrain

SLACK_ROWS = 0.01  # for rounding
SLACK_M = 0.01
Imagers = tuple[Floats, Floats]
"""Places of the left imagers and of the right ones [m], world frame, shape (n, 3) each."""


def doubtful(
    terrain: Terrain,
    camera: Intrinsics,
    origin: Floats,
    rotation: Floats,
    baseline_m: float,
    depth: NDArray[np.float32],
) -> NDArray[np.int64]:
    """Points which the right imager may not see because of terrain: few, so few rays are cast.

    It sees all others, or legs hide them.

    Of a terrain of columns across the course: in the vertical plane along the course, let L and R
    be the imagers and P a point that L sees. The line from R to P can only be blocked where an
    upper corner C of a column lies in the triangle LRP, so the direction from L to P lies between
    those of LC and RC. Between them lies a strip of the image along each corner. Boxes that are no
    columns leave every point in doubt.

    Args:
        terrain: what hides.
        camera: of the left images.
        origin: of the left imagers [m], world frame, shape (n, 3).
        rotation: camera to world, shape (n, 3, 3).
        baseline_m: distance of the imagers.
        depth: of the points in the left images, finite [m], shape (n, height, width).

    Returns:
        Ascending places in the flattened images.
    """
    if terrain.columns is None:
        return np.arange(depth.size)
    right = origin + baseline_m * rotation[..., 0]
    found = _beside(terrain.columns, camera, (origin, right), rotation, depth)
    image, first, last, column = _strips(terrain.columns, camera, (origin, right), rotation)
    tall = last - first
    strip = np.repeat(np.arange(len(tall)), tall)
    row = np.arange(len(strip)) + np.repeat(first - np.cumsum(tall) + tall, tall)
    found.reshape(-1)[(image[strip] * camera.height + row) * camera.width + column[strip]] = True
    return np.flatnonzero(found)


def _beside(
    columns: Columns,
    camera: Intrinsics,
    imagers: Imagers,
    rotation: Floats,
    depth: NDArray[np.float32],
) -> NDArray[np.bool_]:
    """Points of which the corners do not tell all:
    not over the course, or seen from beside it or from within it.
    """
    limit = 0.5 * columns.width - SLACK_M
    left, _ = imagers
    strange = np.zeros(len(left), dtype=np.bool_)
    for imager in imagers:
        strange |= abs(imager[:, 1]) > limit
        strange |= columns.height_at(imager[:, 0]) > imager[:, 2] - SLACK_M
    lateral = rotation[:, 1].astype(np.float32)
    x = ((np.arange(camera.width) + 0.5 - camera.cx) / camera.fx).astype(np.float32)
    y = ((np.arange(camera.height) + 0.5 - camera.cy) / camera.fy).astype(np.float32)
    place = (lateral[:, 1:2] * y + lateral[:, 2:])[:, :, None] + (lateral[:, :1] * x)[:, None, :]
    place *= depth
    place += left[:, 1, None, None].astype(np.float32)
    np.abs(place, out=place)
    return (place > limit) | strange[:, None, None]


def _strips(
    columns: Columns, camera: Intrinsics, imagers: Imagers, rotation: Floats
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Image, first row, end of the rows, and column of each part
    of a column of pixels along a corner.
    """
    top = np.concatenate([[-np.inf], columns.top, [-np.inf]])
    corner_x, corner_z = columns.x, np.maximum(top[1:], top[:-1])
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    edges, rises = [], []
    for imager in imagers:
        ahead, up = corner_x - imager[:, :1], corner_z - imager[:, 2:]
        # cross product of the way to the corner and the direction of a pixel: linear in the pixel's
        # tangents
        across, down, forward = (
            ahead * rotation[:, 2, i : i + 1] - up * rotation[:, 0, i : i + 1] for i in range(3)
        )
        safe = np.where(down == 0.0, 1.0, down)[..., None]
        edges.append(-(across[..., None] * x + forward[..., None]) / safe)
        rises.append(down)
    # where both lines turn the same way, what is between them is one strip; else it may be anything
    plain = (rises[0] * rises[1] > 0.0)[..., None]
    low = np.where(plain, np.minimum(*edges), -np.inf) * camera.fy + (camera.cy - 0.5)
    high = np.where(plain, np.maximum(*edges), np.inf) * camera.fy + (camera.cy - 0.5)
    first = np.clip(np.ceil(low - SLACK_ROWS), 0, camera.height).astype(np.int64)
    last = np.clip(np.floor(high + SLACK_ROWS) + 1.0, 0, camera.height).astype(np.int64)
    image, corner, column = np.nonzero(last > first)
    return image, first[image, corner, column], last[image, corner, column], column


FARTHEST_M = 20.0  # what is farther has a disparity of half a pixel: both imagers see it alike
NEAREST_POINT_M = 0.02  # nothing that a leg could hide comes nearer
# Of the way from the right imager to a point: short of the surface that the point lies on
ALONG_RAY = 0.999


class StereoEmbree(EmbreeRenderer, StereoRenderer):
    """Both views of a stereo camera by Embree, on the CPU. See `StereoRenderer`.

    The second view is one ray for each point of the left image, so it is exact at every pixel and
    has no border; rays that cannot hit terrain are not cast.
    """

    def __init__(
        self, terrain: Terrain, optics: StereoOptics, camera: RobotCamera, *, threads: int = 1
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
        rows, columns, seen = capsule_windows(legs, wide)
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


def right_camera(camera: Intrinsics, optics: StereoOptics, nearest_m: float) -> Intrinsics:
    """A camera at the right imager that sees all that `camera`,
    at the left one, sees from `nearest_m` on.

    It is wider to the left by the largest disparity; what lies outside it counts as visible.
    """
    extra = int(np.ceil(optics.disparity_at_1m / nearest_m / optics.pitch_x))
    return replace(camera, width=camera.width + extra, cx=camera.cx + extra)
