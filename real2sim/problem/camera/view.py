"""Views that a depth camera would have of the claimed terrain from a measured pose."""

from typing import Any

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.camera.pose import claimed_camera
from saltus.real2sim.problem.camera.rays import claimed_scenes
from saltus.real2sim.problem.rotations import unit
from saltus.robots.mount import Mount
from saltus.rotations import rotation_matrix


def expected_depth(poses: Floats, meta: dict[str, Any], rows: Indices, columns: Indices) -> Floats:
    """Depth along the optical axis, for chosen rows and columns of the image.

    Args:
        poses: Position [m] and quaternion (w, x, y, z) of the base in the world, shape (n, 7).
        meta: Contents of `meta.json`: its camera and its terrain.
        rows: Pixels, shape (r,).
        columns: Pixels, shape (c,).

    Returns:
        Shape (n, r, c) [m]; infinite where a ray meets nothing.

    Raises:
        RecordingError: the claimed camera lacks something, or the terrain is neither "flat" nor a list of boxes.
    """
    camera, scene = claimed_camera(meta), claimed_scenes(meta.get("terrain"))[0]
    mount = Mount(position=camera.position, pitch=camera.pitch, roll=camera.roll, yaw=camera.yaw)
    row, column = np.meshgrid(rows, columns, indexing="ij")
    looks = mount.rotation @ camera.tangents(row.ravel(), column.ravel())
    rotation = np.asarray(rotation_matrix(unit(poses[:, 3:])))
    depth = scene.depth(poses[:, :3] + rotation @ mount.position, rotation @ looks)
    return depth.reshape(len(poses), len(rows), len(columns))
