"""Which points of the left image terrain hides from the right imager,
against all boxes for all points.
"""

from typing import Any

import numpy as np
import pytest
from samples import ROBOT

from saltus.config import TerrainConfig
from saltus.depth import supersampled_model_camera
from saltus.render.camera import RobotCamera, camera_pose, ray_directions
from saltus.render.stereo.optics import StereoOptics
from saltus.render.stereo_embree import ALONG_RAY, FARTHEST_M, StereoEmbree, doubtful
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain

CAMERA = supersampled_model_camera(3, 1)
OPTICS = StereoOptics.of(CAMERA)
COUNT = 60
NEAR_EDGE = 1e-5  # [m]: Embree counts in float32


def blocked(terrain: Terrain, start: Any, end: Any, margin: float) -> Any:
    """True if the way from start to end passes through a box that is larger by a margin.

    Shapes (n, 3).
    """
    low = (terrain.arrays.center - terrain.arrays.half_size - margin)[:, None]
    high = (terrain.arrays.center + terrain.arrays.half_size + margin)[:, None]
    way = np.where(end == start, 1e-12, end - start)
    one, other = (low - start) / way, (high - start) / way
    enters = np.max(np.minimum(one, other), axis=-1)
    leaves = np.min(np.maximum(one, other), axis=-1)
    return np.any((np.maximum(enters, 0.0) < np.minimum(leaves, ALONG_RAY)), axis=0)


@pytest.mark.sample(4)
@pytest.mark.parametrize("kind", ["flat", "stairs", "stepping_stones", "step", "gap"])
@pytest.mark.parametrize("wild", [False, True], ids=["upright", "any attitude"])
def test_all_that_boxes_hide_is_in_doubt_and_found(kind: Any, wild: bool) -> None:
    ground = make_terrain(TerrainConfig(terrain=kind))
    rng = np.random.default_rng(7)
    position = rng.uniform(
        [0.0, -2.1 if wild else -0.5, 0.25], [5.0, 2.1 if wild else 0.5, 0.7], (COUNT, 3)
    )
    position[:, 2] += ground.height_at(position[:, 0], position[:, 1])
    limits = np.array([0.6, 1.0, np.pi] if wild else [0.2, 0.3, 0.6])
    quaternion = quaternion_from_roll_pitch_yaw(*rng.uniform(-limits, limits, (COUNT, 3)).T)
    pair = StereoEmbree(ground, OPTICS, RobotCamera.on(ROBOT, CAMERA, legs=False))
    depth, hidden = pair.render_pair_batch(
        position, quaternion, np.tile(ROBOT.stand_pose, (COUNT, 1))
    )
    depth = np.minimum(depth, FARTHEST_M)
    origin, rotation = camera_pose(pair.mount, position, quaternion)
    right = origin + OPTICS.baseline_m * rotation[..., 0]
    inside = ground.height_at(right[:, 0], right[:, 1]) > right[:, 2]
    directions = np.einsum("nij,hwj->nhwi", rotation, ray_directions(CAMERA))
    points = (origin[:, None, None] + directions * depth[..., None]).reshape(-1, 3)
    starts = np.repeat(right, depth[0].size, axis=0)
    # rays of Embree begin and end on surfaces: those that are within rounding of one may go either
    # way
    surely, possibly = (
        blocked(ground, starts, points, margin).reshape(depth.shape)
        for margin in (-NEAR_EDGE, NEAR_EDGE)
    )
    surely, possibly = surely & ~inside[:, None, None], possibly | inside[:, None, None]
    doubt = np.zeros(depth.size, dtype=bool)
    doubt[doubtful(ground, CAMERA, origin, rotation, OPTICS.baseline_m, depth)] = True
    assert not np.any(surely.reshape(-1) & ~doubt)
    assert kind == "flat" or np.any(surely)
    assert np.mean(surely & ~hidden) < 1e-5
    assert np.mean(hidden & ~possibly) < 1e-5
    if not wild:
        assert np.mean(doubt) < 0.3
