import numpy as np
import pytest

from saltus import go1, kinematics
from saltus.config import TerrainKind
from saltus.grid import HEIGHTMAP_X
from saltus.heightmap.data.kinematic import KinematicBounding
from saltus.heightmap.data.planned import PlannedBounding
from saltus.heightmap.data.rollouts import MotionSource, episodes, true_heights
from saltus.heightmap.service.features import PROPRIOCEPTION

KINDS: tuple[TerrainKind, ...] = ("flat", "stairs", "stepping_stones", "step", "gap")
SOURCES: dict[str, MotionSource] = {
    "kinematic": KinematicBounding(ticks=120),
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
def test_feet_that_are_trusted_are_on_the_ground(kind: TerrainKind) -> None:
    source = KinematicBounding(ticks=200, terrains=(kind,))
    for trajectory in source.trajectories(np.random.default_rng(0), 5):
        trusted = trajectory.proprioception[:, [PROPRIOCEPTION.index(f"{leg}_trusted") for leg in go1.LEGS]] > 0
        rotation = kinematics.rotation_matrix(trajectory.quaternion_base_in_world)
        feet = kinematics.foot_position(trajectory.joint_position) @ np.swapaxes(rotation, -1, -2)
        feet = feet + trajectory.position_base_in_world[:, None]
        gap = feet[..., 2] - go1.FOOT_RADIUS - trajectory.terrain.height_at(feet[..., 0])
        # Within the reach error of the script, but for feet that stand within it of an edge.
        assert np.mean(np.abs(gap[trusted]) < 0.011) > 0.95
        assert trusted.mean() > 0.05


@pytest.mark.parametrize("kind", KINDS)
def test_true_heights_are_the_terrain_along_the_yaw(kind: TerrainKind) -> None:
    (trajectory,) = KinematicBounding(ticks=50, terrains=(kind,)).trajectories(np.random.default_rng(1), 1)
    position, quaternion = trajectory.position_base_in_world, trajectory.quaternion_base_in_world
    heights = true_heights(trajectory.terrain, position, quaternion)
    for i in (0, 20, 49):
        ahead = kinematics.rotation_matrix(quaternion[i])[:2, 0]
        points = position[i, 0] + HEIGHTMAP_X * ahead[0] / np.linalg.norm(ahead)
        np.testing.assert_allclose(heights[i], trajectory.terrain.height_at(points) - position[i, 2], atol=1e-12)
