import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from saltus.config import TerrainConfig
from saltus.errors import ConfigError
from saltus.sim import scene
from saltus.terrain import stepping_stones
from saltus.terrain.curriculum import TABLE, make_terrain
from saltus.terrain.stack import TerrainStack
from saltus.terrain.terrain import Terrain

KINDS = tuple(TABLE)
FAMILY = [TerrainConfig(terrain=kind, difficulty=d) for kind in KINDS for d in (None, 0.0, 0.4, 1.0)]


def name_of(config: TerrainConfig) -> str:
    return f"{config.terrain}-{config.difficulty}"


def random_x(terrain: Terrain, count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(terrain.column_x[0], terrain.column_x[-1], count)


@pytest.mark.parametrize("config", FAMILY, ids=name_of)
def test_height_equals_a_downward_ray(config: TerrainConfig) -> None:
    terrain = make_terrain(config)
    model = scene.build_spec(terrain).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    groups = np.zeros(6, dtype=np.uint8)
    groups[scene.TERRAIN_GROUP] = 1
    down, hit, top = np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32), 10.0
    x = random_x(terrain, 10_000)
    y = np.random.default_rng(1).uniform(-0.5, 0.5, x.shape) * terrain.width
    ray = [
        mujoco.mj_ray(model, data, np.array([a, b, top]), down, groups, 1, -1, hit) for a, b in zip(x, y, strict=True)
    ]
    np.testing.assert_allclose(terrain.height_at(x), top - np.array(ray), atol=1e-3)


@pytest.mark.parametrize("config", FAMILY, ids=name_of)
def test_edges_are_where_the_height_changes_and_belong_to_the_higher_side(config: TerrainConfig) -> None:
    terrain = make_terrain(config)
    walls = terrain.column_x[1:-1]
    changes = walls[np.diff(terrain.column_top) != 0.0]
    assert set(changes) <= set(terrain.edges_x)
    assert np.all(np.diff(terrain.edges_x) > 0.0)
    for x in terrain.edges_x:
        assert terrain.height_at(x) == max(terrain.height_at(x - 1e-9), terrain.height_at(x + 1e-9))
    if terrain.edges_x.size:
        assert terrain.first_edge_x == 1.5
        assert terrain.timing_x == 1.0
        assert terrain.finish_x - terrain.last_edge_x == pytest.approx(
            1.0 if config.terrain in ("step", "gap") else 0.5
        )


@pytest.mark.parametrize("config", FAMILY, ids=name_of)
def test_there_is_ground_behind_the_start_and_the_finish(config: TerrainConfig) -> None:
    terrain = make_terrain(config)
    assert terrain.column_x[0] == -2.0
    assert terrain.column_x[-1] == pytest.approx(terrain.finish_x + 4.0)
    assert np.all(terrain.height_at(np.linspace(-2.0, 1.49, 100)) == 0.0)
    assert np.ptp(terrain.height_at(np.linspace(max(terrain.last_edge_x, 1.5), terrain.finish_x + 4.0, 100))) == 0.0


@pytest.mark.parametrize("config", FAMILY, ids=name_of)
def test_boxes_tile_the_course_without_crack_or_overlap(config: TerrainConfig) -> None:
    terrain = make_terrain(config)
    low, high = (terrain.box_center + side * terrain.box_size for side in (-0.5, 0.5))
    np.testing.assert_allclose(low[1:, 0], high[:-1, 0], atol=1e-12)
    np.testing.assert_allclose(high[:, 2], terrain.column_top, atol=1e-12)
    assert np.all(terrain.box_size > 0.0)
    assert np.all(terrain.box_size[:, 1] == 4.0)


@pytest.mark.parametrize("config", FAMILY, ids=name_of)
def test_torch_equals_numpy_in_any_shape(config: TerrainConfig) -> None:
    terrain = make_terrain(config)
    x = np.concatenate([random_x(terrain, 98), [-50.0, 50.0]])
    heights = terrain.height_at(x)
    for shape in ((100,), (4, 25), (2, 5, 10)):
        np.testing.assert_array_equal(terrain.height_at(x.reshape(shape)), heights.reshape(shape))
        assert torch.equal(
            terrain.height_at(torch.from_numpy(x.reshape(shape))), torch.from_numpy(heights.reshape(shape))
        )
    single = terrain.height_at(torch.from_numpy(x).float())
    assert single.dtype == torch.float32
    np.testing.assert_allclose(single.numpy(), heights, atol=1e-6)


def test_a_stack_equals_its_terrains() -> None:
    terrains = [make_terrain(config) for config in FAMILY]
    stack = TerrainStack(terrains)
    x = np.random.default_rng(0).uniform(-3.0, 20.0, (len(terrains), 200))
    x[:, 0] = [t.edges_x[0] if t.edges_x.size else 0.0 for t in terrains]
    expected = np.stack([t.height_at(row) for t, row in zip(terrains, x, strict=True)])
    np.testing.assert_array_equal(stack.height_at(x), expected)
    assert torch.equal(stack.height_at(torch.from_numpy(x)), torch.from_numpy(expected))


@given(st.floats(0.0, 1.0))
@settings(max_examples=50, deadline=None)
def test_difficulty_sets_the_sizes(d: float) -> None:
    made = {kind: make_terrain(TerrainConfig(terrain=kind, difficulty=d)).params for kind in KINDS}
    assert made["stairs"]["rise_m"] == pytest.approx(0.05 + 0.25 * d)
    assert made["stepping_stones"]["gap_m"] == pytest.approx(0.6 * d)
    assert made["stepping_stones"]["stone_m"] == 0.5
    assert made["gap"]["gap_m"] == pytest.approx(0.01 + 1.1 * d)
    assert made["step"]["height_m"] == pytest.approx(0.8 * d)


@pytest.mark.parametrize(("kind", "size"), [(kind, size) for kind in KINDS for size in TABLE[kind]])
def test_an_explicit_size_wins_and_comes_back_and_is_bounded(kind: str, size: str) -> None:
    law = TABLE[kind][size]
    for value in (law.low, law.high):
        given_size = int(value) if size == "steps" else value
        assert make_terrain(TerrainConfig(terrain=kind, difficulty=0.3, **{size: given_size})).params[size] == value
    for value in (law.low - 1e-6, law.high + 1e-6, float("nan")):
        with pytest.raises(ConfigError, match=rf"{size} = .*{law.low:g} to {law.high:g}"):
            make_terrain(TerrainConfig(terrain=kind, **{size: value}))


@pytest.mark.parametrize("difficulty", [-0.01, 1.01, float("nan"), float("inf")])
@pytest.mark.parametrize("kind", KINDS)
def test_difficulty_is_bounded(kind: str, difficulty: float) -> None:
    with pytest.raises(ConfigError, match=r"difficulty = .* from 0 to 1"):
        make_terrain(TerrainConfig(terrain=kind, difficulty=difficulty))


@pytest.mark.parametrize("kind", KINDS)
def test_a_size_of_another_terrain_is_an_error(kind: str) -> None:
    for size in {"rise_m", "gap_m", "stone_m", "height_m"} - set(TABLE[kind]):
        with pytest.raises(ConfigError, match=rf"{size} = 0.2 has no meaning for terrain '{kind}'"):
            make_terrain(TerrainConfig(terrain=kind, **{size: 0.2}))


def test_drawn_gaps_keep_their_range_and_their_seed() -> None:
    def gaps(seed: int) -> np.ndarray:
        rng = np.random.default_rng(seed)
        terrain = stepping_stones.make(steps=8, stone_m=0.5, gap_m=0.1, gap_max_m=0.4, rng=rng)
        return np.diff(terrain.edges_x)[::2]

    np.testing.assert_array_equal(gaps(1), gaps(1))
    assert np.all((gaps(1) >= 0.1 - 1e-12) & (gaps(1) <= 0.4 + 1e-12))
    assert len(gaps(1)) == 9
    assert not np.array_equal(gaps(1), gaps(2))
    with pytest.raises(ConfigError, match="generator"):
        stepping_stones.make(steps=8, stone_m=0.5, gap_m=0.1, gap_max_m=0.4)
