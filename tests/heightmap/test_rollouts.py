import numpy as np
import pytest
from synthetic_motion import TERRAINS, gliding_robots

from saltus import rotations
from saltus.grid import HEIGHTMAP_X, LINE
from saltus.loop.heights import true_heights


@pytest.mark.parametrize("kind", TERRAINS)
def test_true_heights_are_the_terrain_along_the_yaw(kind: str) -> None:
    (trajectory,) = gliding_robots(np.random.default_rng(1), 1, ticks=50, terrains=(kind,))
    position, quaternion = trajectory.position_base_in_world, trajectory.quaternion_base_in_world
    heights = true_heights(trajectory.terrain, position, quaternion, LINE)
    for i in (0, 20, 49):
        ahead = rotations.rotation_matrix(quaternion[i])[:2, 0]
        points = position[i, 0] + HEIGHTMAP_X * ahead[0] / np.linalg.norm(ahead)
        np.testing.assert_allclose(
            heights[i], trajectory.terrain.height_at(points, 0.0) - position[i, 2], atol=1e-12
        )
