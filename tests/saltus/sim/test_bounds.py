import mujoco
import numpy as np
import pytest
from random_terrain import random_terrain
from samples import ROBOT

from saltus.config import TerrainConfig
from saltus.sim import robot_model
from saltus.sim.mujoco_batch import terrain_nodes, tree_bounds
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain
from saltus.terrain.terrain_stack import TerrainStack


@pytest.mark.parametrize(
    "terrain", [make_terrain(TerrainConfig()), random_terrain(0), random_terrain(1)]
)
def test_the_tree_of_a_terrain_is_the_one_the_engine_makes_of_it(terrain: Terrain) -> None:
    model: mujoco.MjModel = robot_model.build_spec(ROBOT, terrain).compile()
    bounds = tree_bounds(model, TerrainStack([terrain]).boxes(len(terrain.boxes)))[0]
    made = model.bvh_aabb[terrain_nodes(model)].reshape(-1, 6)
    low, high = (bounds[:, :3] + side * bounds[:, 3:] for side in (-1.0, 1.0))
    made_low, made_high = (made[:, :3] + side * made[:, 3:] for side in (-1.0, 1.0))
    np.testing.assert_allclose(low, made_low, atol=1e-9)
    np.testing.assert_allclose(high, made_high, atol=1e-9)
