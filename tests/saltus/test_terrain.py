from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from random_terrain import places, random_terrain
from samples import ROBOT
from terrain_families import FAMILY, name_of

from saltus.config import TerrainConfig
from saltus.errors import ConfigError
from saltus.sim import robot_model
from saltus.terrain.boxes import Box, Boxes
from saltus.terrain.course_law import KINDS as LEVEL
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import WIDTH, Terrain, check_terrain
from saltus.terrain.terrain_stack import TerrainStack

LEVEL_FAMILY = [config for config in FAMILY if config.terrain in LEVEL]


RAMPS = [config for config in FAMILY if config not in LEVEL_FAMILY]


SINGLE = ("step", "step_down", "gap", "ditch")


def random_x(terrain: Terrain, count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(
        terrain.boxes[0].low[0], terrain.boxes[-1].high[0], count
    )


def by_rays(terrain: Terrain, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height by MuJoCo's rays, straight down from above all boxes."""
    model = robot_model.build_spec(ROBOT, terrain).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    groups = np.zeros(6, dtype=np.uint8)
    groups[robot_model.TERRAIN_GROUP] = 1
    down, hit, top = np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32), 10.0
    starts = (np.array([a, b, top]) for a, b in zip(x, y, strict=True))
    return np.array(
        [top - mujoco.mj_ray(model, data, start, down, groups, 1, -1, hit) for start in starts]
    )


@pytest.mark.parametrize("config", FAMILY, ids=name_of)
def test_height_equals_a_downward_ray(config: TerrainConfig) -> None:
    terrain = make_terrain(config)
    x = random_x(terrain, 10_000)
    y = np.random.default_rng(1).uniform(-0.5, 0.5, x.shape) * WIDTH
    np.testing.assert_allclose(terrain.height_at(x, y), by_rays(terrain, x, y), atol=1e-3)


@pytest.mark.parametrize("seed", range(20))
def test_height_over_turned_boxes_equals_a_downward_ray(seed: int) -> None:
    terrain = random_terrain(seed)
    x, y = places(terrain, 500, seed)
    np.testing.assert_allclose(terrain.height_at(x, y), by_rays(terrain, x, y), atol=1e-6)


@pytest.mark.parametrize("config", LEVEL_FAMILY, ids=name_of)
def test_columns_are_as_high_as_the_same_boxes_one_by_one(config: TerrainConfig) -> None:
    terrain = make_terrain(config)
    assert terrain.columns is not None
    x = np.concatenate([random_x(terrain, 500), terrain.edges_x, [-50.0, 50.0]])
    one_by_one = terrain.arrays.height_at(x, np.random.default_rng(1).uniform(-3.0, 3.0, x.shape))
    np.testing.assert_allclose(one_by_one, terrain.height_at(x, 0.0), atol=1e-12)


@given(
    st.tuples(st.floats(-3, 3), st.floats(-1, 1)),
    st.floats(0.1, 3),
    st.floats(-1, 1),
    st.floats(0.1, 2),
)
@settings(max_examples=50, deadline=None)
def test_a_ramp_leads_from_one_place_to_another(
    start: tuple[float, float], ahead: float, up: float, thickness: float
) -> None:
    ramp = Box.ramp(start, (start[0] + ahead, start[1] + up), 2.0, thickness)
    terrain = Terrain(kind="ramp", boxes=(ramp,), finish_x=3.0)
    share = np.linspace(0.01, 0.99, 9)
    heights = terrain.height_at(start[0] + share * ahead, np.linspace(-0.99, 0.99, 9))
    np.testing.assert_allclose(heights, start[1] + share * up, atol=1e-9)
    with pytest.raises(ConfigError, match="ahead of its start"):
        Box.ramp(start, (start[0], start[1] + up), 2.0)


def test_a_ramp_is_where_the_convention_says() -> None:
    """Pitch is nose down positive and comes before the yaw, about the box's centre."""
    ramp = Box.at((1.0, 2.0, 0.5), (4.0, 2.0, 0.2), pitch=-0.3)
    up = Terrain(kind="ramp", boxes=(ramp,), finish_x=3.0)
    over = 0.1 / np.cos(0.3)  # half the thickness, along the plumb line
    x = np.linspace(-0.5, 2.5, 7)
    np.testing.assert_allclose(
        up.height_at(x, 2.0), 0.5 + over + np.tan(0.3) * (x - 1.0), atol=1e-12
    )
    aside = replace(up, boxes=(replace(ramp, yaw=0.5 * np.pi),))
    y = np.linspace(0.5, 3.5, 7)
    np.testing.assert_allclose(
        aside.height_at(np.ones(7), y), 0.5 + over + np.tan(0.3) * (y - 2.0), atol=1e-12
    )


@pytest.mark.parametrize("seed", range(3))
def test_the_rim_goes_on_and_holes_have_the_lowest_underside(seed: int) -> None:
    terrain = random_terrain(seed)
    y = np.linspace(-1.9, 1.9, 50)
    reach = terrain.arrays.center[:, 0] + terrain.arrays.extent[:, 0]
    np.testing.assert_array_equal(
        terrain.height_at(0.0 * y + 90.0, y), terrain.height_at(0.0 * y + reach.max(), y)
    )
    far = Terrain(
        kind="two", boxes=(Box.at((0, 0, 0), (1, 1, 1)), Box.at((5, 0, 0), (1, 1, 2))), finish_x=5.0
    )
    assert far.height_at(2.0, 0.0) == -1.0
    np.testing.assert_array_equal(
        far.height_at(np.array([-0.5, 0.5, 4.5, 5.5, 9.0]), 0.0), [0.5, 0.5, 1.0, 1.0, 1.0]
    )


@pytest.mark.parametrize("config", LEVEL_FAMILY, ids=name_of)
def test_edges_are_where_the_height_changes_and_belong_to_the_higher_side(
    config: TerrainConfig,
) -> None:
    terrain = make_terrain(config)
    changes = [
        box.high[0] for box, beyond in pairwise(terrain.boxes) if box.high[2] != beyond.high[2]
    ]
    assert set(changes) <= set(terrain.edges_x)
    assert np.all(np.diff(terrain.edges_x) > 0.0)
    for x in terrain.edges_x:
        assert terrain.height_at(x, 0.0) == max(
            terrain.height_at(x - 1e-9, 0.0), terrain.height_at(x + 1e-9, 0.0)
        )
    if terrain.edges_x.size == 0:
        assert (terrain.timing_x, terrain.timed) == (terrain.start_x, "from the start")
    else:
        assert terrain.first_edge_x == 1.5
        assert (terrain.timing_x, terrain.timed) == (1.0, "from 0.5 m before the first edge")
        assert terrain.finish_x - terrain.edges_x[-1] == pytest.approx(
            1.0 if config.terrain in SINGLE else 0.5
        )


def test_edges_of_turned_boxes_are_their_ends_along_the_course() -> None:
    ground = Box.at((3.0, 0.0, -0.5), (10.0, 4.0, 1.0))
    ramp = Box.at((3.0, 0.0, 0.0), (1.0, 1.0, 0.1), yaw=0.25 * np.pi)
    behind = Box.at((-1.0, 0.0, 0.0), (0.2, 0.2, 0.2))
    terrain = Terrain(kind="boxes", boxes=(ground, ramp, behind), finish_x=6.0)
    np.testing.assert_allclose(terrain.edges_x, [3.0 - np.sqrt(0.5), 3.0 + np.sqrt(0.5)], atol=1e-9)
    assert terrain.timing_x == terrain.first_edge_x - 0.5


@pytest.mark.parametrize("config", FAMILY, ids=name_of)
def test_there_is_ground_behind_the_start_and_the_finish(config: TerrainConfig) -> None:
    terrain = make_terrain(config)
    assert terrain.boxes[0].low[0] == -2.0
    assert terrain.boxes[-1].high[0] == pytest.approx(terrain.finish_x + 4.0)
    assert np.all(terrain.height_at(np.linspace(-2.0, 1.49, 100), 0.0) == 0.0)
    behind = np.linspace(max([1.5, *terrain.edges_x]) + 1e-6, terrain.finish_x + 4.0, 100)
    assert np.ptp(terrain.height_at(behind, 0.0)) < 1e-9
    assert check_terrain(terrain, config.terrain) is terrain
    lowest = terrain.height_at(np.linspace(-2.0, terrain.finish_x, 1000), 0.0).min()
    assert all(box.low[2] <= lowest - 0.6 + 1e-9 for box in terrain.boxes if box.is_level)


@pytest.mark.parametrize("config", RAMPS, ids=name_of)
def test_a_ramp_family_leads_from_level_ground_to_level_ground(config: TerrainConfig) -> None:
    terrain = make_terrain(config)
    slope, run = np.tan(np.deg2rad(terrain.params["slope_deg"])), terrain.params["run_m"]
    way = np.linspace(0.0, run, 50)
    side = -1.0 if config.terrain == "ramp_down" else 1.0
    np.testing.assert_allclose(terrain.height_at(1.5 + way, 0.0), side * slope * way, atol=1e-9)
    np.testing.assert_allclose(terrain.edges_x, [1.5, 1.5 + run], atol=1e-9)
    assert terrain.finish_x == pytest.approx(2.0 + run)


@pytest.mark.parametrize("config", LEVEL_FAMILY, ids=name_of)
def test_boxes_tile_the_course_without_crack_or_overlap(config: TerrainConfig) -> None:
    terrain = make_terrain(config)
    low, high = (terrain.arrays.center + side * terrain.arrays.half_size for side in (-1.0, 1.0))
    np.testing.assert_allclose(low[1:, 0], high[:-1, 0], atol=1e-12)
    np.testing.assert_allclose(high[:, 2], [box.high[2] for box in terrain.boxes], atol=1e-12)
    assert np.all(terrain.arrays.half_size > 0.0)
    assert np.all(terrain.arrays.half_size[:, 1] == 2.0)


ANY = [*map(make_terrain, LEVEL_FAMILY), *map(make_terrain, RAMPS), *map(random_terrain, range(5))]


@pytest.mark.parametrize("terrain", ANY, ids=lambda terrain: terrain.fingerprint)
def test_torch_equals_numpy_in_any_shape(terrain: Terrain) -> None:
    x, y = places(terrain, 98, seed=2)
    x, y = np.concatenate([x, [-50.0, 50.0]]), np.concatenate([y, [0.0, 0.0]])
    heights = terrain.height_at(x, y)
    # Sines of torch are rounded otherwise
    exactly = {
        "atol": 0.0 if terrain.columns else 1e-12,
        "rtol": 0.0,
    }
    for shape in ((100,), (4, 25), (2, 5, 10)):
        np.testing.assert_array_equal(
            terrain.height_at(x.reshape(shape), y.reshape(shape)), heights.reshape(shape)
        )
        places_there = (torch.from_numpy(each.reshape(shape)) for each in (x, y))
        np.testing.assert_allclose(
            terrain.height_at(*places_there).numpy(), heights.reshape(shape), **exactly
        )
    single = terrain.height_at(torch.from_numpy(x).float(), torch.from_numpy(y).float())
    assert single.dtype == torch.float32
    np.testing.assert_allclose(single.numpy(), heights, atol=1e-6 if terrain.columns else 2e-5)
    assert float(terrain.height_at(float(x[0]), float(y[0]))) == heights[0]


@pytest.mark.parametrize("terrains", [ANY[: len(LEVEL_FAMILY)], ANY], ids=["columns", "any boxes"])
def test_a_stack_equals_its_terrains(terrains: list[Terrain]) -> None:
    stack = TerrainStack(terrains)
    rng = np.random.default_rng(0)
    x, y = (
        rng.uniform(-3.0, 20.0, (len(terrains), 200)),
        rng.uniform(-2.5, 2.5, (len(terrains), 200)),
    )
    x[:, 0] = [t.edges_x[0] if t.edges_x.size else 0.0 for t in terrains]
    expected = np.stack([t.height_at(*row) for t, *row in zip(terrains, x, y, strict=True)])
    np.testing.assert_allclose(
        stack.height_at(x, y), expected, atol=0.0 if len(terrains) == len(LEVEL_FAMILY) else 1e-12
    )
    np.testing.assert_allclose(
        stack.height_at(torch.from_numpy(x), torch.from_numpy(y)).numpy(), expected, atol=1e-12
    )


@pytest.mark.parametrize("terrain", ANY, ids=lambda terrain: terrain.fingerprint)
def test_a_terrain_reads_back_equal_to_the_bit(terrain: Terrain) -> None:
    again = Terrain.from_toml(terrain.to_toml())
    assert again == terrain
    assert again.params == terrain.params
    assert again.fingerprint == terrain.fingerprint
    x, y = places(terrain, 100, seed=3)
    np.testing.assert_array_equal(again.height_at(x, y), terrain.height_at(x, y))
    np.testing.assert_array_equal(again.edges_x, terrain.edges_x)


def test_fingerprints_differ() -> None:
    assert len({terrain.fingerprint for terrain in ANY}) == len(set(ANY))


def test_a_box_may_be_written_with_its_centre_and_comes_back_as_a_run_log_has_it() -> None:
    table = {"center": [1.0, 0.5, -0.25], "size": [4.0, 3.0, 0.5], "pitch": -0.25, "yaw": 0.5}
    lines = "\n".join(f"{key} = {value}" for key, value in table.items())
    ramp = Terrain.from_toml(f"kind = 'ramp'\nfinish_x = 3\n[[boxes]]\n{lines}")
    assert ramp.boxes == (Box(low=(-1.0, -1.0, -0.5), high=(3.0, 2.0, 0.0), pitch=-0.25, yaw=0.5),)
    assert ramp.arrays.to_tables() == [table]
    level = {"center": [1.0, 0.5, -0.25], "size": [4.0, 3.0, 0.5]}
    assert Boxes.from_tables([level, table]).to_tables() == [level, table]


BOX = "[[boxes]]\nlow = [0, 0, 0]\nhigh = [1, 1, 1]"


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("kind = 'x'\nfinish_x = 1.0\nboxes = []", "at least one"),
        ("kind = 'x'\nfinish_x = 1.0", "boxes"),
        ("kind = 'x'\nfinish_x = 1.0\nboxes = 3", "list"),
        ("kind = 'x'\nfinish_x = 1.0\nboxes = [3]", "table"),
        (f"kind = 'x'\nfinish_x = inf\n{BOX}", "finite"),
        (f"kind = 'x'\nfinish_x = 1.0\n{BOX}\nroll = 1.0", "unknown key"),
        (f"kind = 'x'\nfinish_x = 1.0\n{BOX}\npitch = nan", "must be a number"),
        (
            "kind = 'x'\nfinish_x = 1.0\n[[boxes]]\nlow = [0, 0, 0]\nhigh = [1, 0, 1]",
            "more than 0 m",
        ),
        ("kind = 'x'\nfinish_x = 1.0\n[[boxes]]\nlow = [0, 0, 0]\nhigh = [1, 1]", "3 entries"),
        (
            "kind = 'x'\nfinish_x = 1.0\n[[boxes]]\ncenter = [0, 0, 0]\nsize = [1, 1, -1]",
            "more than 0 m",
        ),
        (
            "kind = 'x'\nfinish_x = 1.0\n[[boxes]]\ncenter = [0, 0, 0]\nsizes = [1, 1, 1]",
            r"unknown key 'boxes\[0\]",
        ),
    ],
)
def test_what_is_no_terrain_is_refused(text: str, named: str) -> None:
    with pytest.raises(ConfigError, match=named) as error:
        Terrain.from_toml(text)
    assert "\n" not in str(error.value)
