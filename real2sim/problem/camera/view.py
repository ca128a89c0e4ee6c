"""What a depth camera would see of flat floor and boxes from a measured pose: the plainest geometry, no renderer."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from saltus.arrays import Floats, Indices


def expected_depth(
    poses: Floats, camera: dict[str, Any], terrain: list[dict[str, Any]], rows: Indices, columns: Indices
) -> Floats:
    """Depth along the optical axis, for chosen rows and columns of the image.

    Args:
        poses: Position [m] and quaternion (w, x, y, z) of the base in the world, shape (n, 7).
        camera: As `meta.json` claims it.
        terrain: Boxes in the world frame, `center` and full `size` [m].
        rows: Pixels, shape (r,).
        columns: Pixels, shape (c,).

    Returns:
        Shape (n, r, c) [m]; infinite where a ray meets nothing.
    """
    u = (columns + 0.5 - camera["cx"]) / camera["fx"]
    v = (rows + 0.5 - camera["cy"]) / camera["fy"]
    right, down = np.meshgrid(u, v)
    # The camera looks along x of the trunk, turned nose down about y; a ray advances one metre along the axis
    rays = np.stack([np.ones_like(right), -right, -down], axis=-1).reshape(-1, 3)
    rays = Rotation.from_euler("y", float(camera["pitch"])).apply(rays)
    base = Rotation.from_quat(poses[:, 3:], scalar_first=True).as_matrix()
    eyes = (poses[:, :3] + base @ np.asarray(camera["position"], float))[:, None]
    rays = np.einsum("nij,pj->npi", base, rays)
    with np.errstate(divide="ignore", invalid="ignore"):
        nearest = np.where(rays[..., 2] < 0, -eyes[..., 2] / rays[..., 2], np.inf)
        for box in terrain:
            half = 0.5 * np.asarray(box["size"], float)
            low, high = ((np.asarray(box["center"], float) + side * half - eyes) / rays for side in (-1, 1))
            enter, leave = np.minimum(low, high).max(axis=-1), np.maximum(low, high).min(axis=-1)
            nearest = np.where((enter > 0) & (enter < leave), np.minimum(nearest, enter), nearest)
    return np.where(nearest > 0, nearest, np.inf).reshape(len(poses), len(rows), len(columns))
