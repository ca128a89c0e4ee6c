import numpy as np
import pytest
from synthetic_motion import GlidingRobots

from saltus import rotations
from saltus.config import TerrainKind
from saltus.grid import HEIGHTMAP_X
from saltus.heightmap.data.planned import PlannedBounding
from saltus.heightmap.data.rollouts import MotionSource, episodes, true_heights
from saltus.heightmap.service.features import PROPRIOCEPTION

KINDS: tuple[TerrainKind, ...] = ("flat", "stairs", "stepping_stones", "step", "gap")
SOURCES: dict[str, MotionSource] = {
    "synthetic": GlidingRobots(ticks=120),
    "planned": PlannedBounding(robots=4, time_limit_s=1.6),
}


@pytest.mark.parametrize("name", SOURCES)
def test_episodes_are_whole_and_repeatable(name: str) -> None:
    first, second = (list(episodes(SOURCES[name], np.random.default_rng(3), 4)) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        ticks = len(a.height)
        assert a.height.shape == (ticks, 30)
        assert a.proprioception.shape == (ticks, len(PROPRIOCEPTION))
        assert a.depth.shape == (len(a.frame_tick), 48, 16)
        assert np.isfinite(a.proprioception).all()
        np.testing.assert_array_equal(a.depth, b.depth)
        np.testing.assert_array_equal(a.height, b.height)


@pytest.mark.parametrize("kind", KINDS)
def test_true_heights_are_the_terrain_along_the_yaw(kind: TerrainKind) -> None:
    (trajectory,) = GlidingRobots(ticks=50, terrains=(kind,)).trajectories(np.random.default_rng(1), 1)
    position, quaternion = trajectory.position_base_in_world, trajectory.quaternion_base_in_world
    heights = true_heights(trajectory.terrain, position, quaternion)
    for i in (0, 20, 49):
        ahead = rotations.rotation_matrix(quaternion[i])[:2, 0]
        points = position[i, 0] + HEIGHTMAP_X * ahead[0] / np.linalg.norm(ahead)
        np.testing.assert_allclose(heights[i], trajectory.terrain.height_at(points, 0.0) - position[i, 2], atol=1e-12)
