"""Both views of a stereo camera by two images, one drawn from each imager."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.depth import Intrinsics
from saltus.render.camera import RobotCamera
from saltus.render.pyrender_osmesa import PyrenderRenderer
from saltus.render.renderer import StereoRenderer
from saltus.render.stereo.optics import StereoOptics
from saltus.terrain.terrain import Terrain

# What is nearer is outside of the right image and counts as visible: a D435i at 424x240 does not
# measure it anyway, its disparities end at 126 px (8.4 cm)
NEAREST_M = 0.08
# A point falls between pixels of the right image: up to half a pixel away, the same surface may be
# nearer by this much
TOLERANCE_PX = 1.0
IMAGES_PER_PASS = 64  # right images in memory: 13 MB of a D435i's


class StereoPyrender(PyrenderRenderer, StereoRenderer):
    """Both views of a stereo camera by pyrender. See `StereoRenderer`.

    The right image has the rows of the left one and the columns of the sensor, however few the left
    one has of these. A shadow's border is exact to half a column; what is less than a pixel of
    disparity behind counts as visible.
    """

    def __init__(self, terrain: Terrain, optics: StereoOptics, camera: RobotCamera) -> None:
        super().__init__(terrain, camera)
        self.optics = optics
        self._right = PyrenderRenderer(terrain, right_imager(camera, optics))

    def render_pair_batch(
        self, base_position: Floats, base_quaternion: Floats, joint_position: Floats
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """See `StereoRenderer`."""
        depth = self.render_batch(base_position, base_quaternion, joint_position)
        hidden = np.empty(depth.shape, np.bool_)
        for first in range(0, len(depth), IMAGES_PER_PASS):
            part = slice(first, first + IMAGES_PER_PASS)
            right = self._right.render_batch(
                base_position[part], base_quaternion[part], joint_position[part]
            )
            hidden[part] = hidden_by_image(
                depth[part], right, self.intrinsics, self._right.intrinsics, self.optics.baseline_m
            )
        return depth, hidden


def right_imager(camera: RobotCamera, optics: StereoOptics) -> RobotCamera:
    """The right one of a pair as a camera of its own:
    it sees all that `camera`, the left one, sees from 8 cm on.
    """
    left, mount = camera.intrinsics, camera.mount
    fx = left.fx * optics.pitch_x
    extra = math.ceil(optics.baseline_m * fx / NEAREST_M)
    wide = replace(
        left,
        width=math.ceil(left.width * optics.pitch_x) + extra,
        fx=fx,
        cx=left.cx * optics.pitch_x + extra,
    )
    right = mount.position + optics.baseline_m * mount.rotation[:, 0]
    return replace(camera, intrinsics=wide, mount=replace(mount, position=right))


def hidden_by_image(
    depth: NDArray[np.float32],
    right_depth: NDArray[np.float32],
    left: Intrinsics,
    right: Intrinsics,
    baseline_m: float,
) -> NDArray[np.bool_]:
    """Which points of left images are not in the images from the right,
    because something nearer is in their place.

    Args:
        depth: of the points, along the optical axis [m], infinite where nothing is hit, shape (n,
            height, width).
        right_depth: as the right imager sees it, shape (n, height, wide).
        left: of the left images.
        right: of the right images, with the same rows.
        baseline_m: distance of the imagers.
    """
    disparity, seen = (np.float32(baseline_m * right.fx) / image for image in (depth, right_depth))
    column = (np.arange(left.width) + 0.5 - left.cx) * (right.fx / left.fx) + right.cx
    place = np.floor(column.astype(np.float32) - disparity).astype(np.int64)
    there = np.take_along_axis(seen, np.maximum(place, 0), axis=-1)
    hidden: NDArray[np.bool_] = (place >= 0) & (there > disparity + np.float32(TOLERANCE_PX))
    return hidden
