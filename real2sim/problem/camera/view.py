"""What a depth camera would see of the claimed terrain from a measured pose."""

from typing import Any

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.real2sim.problem.camera.pose import claimed_camera
from saltus.real2sim.problem.camera.rays import claimed_scenes
from saltus.real2sim.problem.rotations import unit
from saltus.render.camera import Mount
from saltus.rotations import rotation_matrix


def expected_depth(poses: Floats, meta: dict[str, Any], rows: Indices, columns: Indices) -> Floats:
    """Depth along the optical axis [m], shape (n, r, c), for chosen rows and columns of the image.

    Poses are position [m] and quaternion (w, x, y, z) of the base in the world, shape (n, 7); `meta` holds camera and
    terrain as `meta.json`. Infinite where a ray meets nothing. `RecordingError` for claims that cannot be.
    """
    camera, scene = claimed_camera(meta), claimed_scenes(meta.get("terrain"))[0]
    mount = Mount(position=camera.position, pitch=camera.pitch)
    row, column = np.meshgrid(rows, columns, indexing="ij")
    looks = mount.rotation @ camera.tangents(row.ravel(), column.ravel())
    rotation = np.asarray(rotation_matrix(unit(poses[:, 3:])))
    depth = scene.depth(poses[:, :3] + rotation @ mount.position, rotation @ looks)
    return depth.reshape(len(poses), len(rows), len(columns))
