import numpy as np
import pytest
import torch

from saltus.errors import ConfigError
from saltus.grid import HEIGHTMAP_X, LINE, SCAN, SCAN_AND_LINE, HeightGrid
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix

FIELD = HeightGrid(x=(-0.4, 0.1, 0.8), y=(-0.2, 0.0, 0.3))


def test_the_originals_line_is_a_grid_of_30_by_1() -> None:
    assert LINE.shape == (30, 1)
    assert LINE.size == 30
    np.testing.assert_array_equal(LINE.points[:, 0], np.linspace(-0.4, 0.8, 30))
    np.testing.assert_array_equal(HEIGHTMAP_X, LINE.points[:, 0])
    assert not LINE.points[:, 1].any()


def test_points_stand_row_by_row() -> None:
    assert FIELD.points.shape == (9, 2)
    np.testing.assert_array_equal(FIELD.points[:3], [[-0.4, -0.2], [-0.4, 0.0], [-0.4, 0.3]])
    np.testing.assert_array_equal(FIELD.points.reshape(*FIELD.shape, 2)[:, 1, 0], FIELD.x)


@pytest.mark.parametrize("grid", [LINE, FIELD], ids=["line", "field"])
def test_points_in_the_world_are_turned_by_the_yaw_alone(grid: HeightGrid) -> None:
    rng = np.random.default_rng(0)
    position, yaw = rng.normal(size=(2, 5, 3)), rng.uniform(-np.pi, np.pi, (2, 5))
    turn = rotation_matrix(quaternion_from_roll_pitch_yaw(0.0 * yaw, 0.0 * yaw, yaw))
    flat = np.concatenate([grid.points, np.zeros((grid.size, 1))], axis=1)
    expected = position[..., None, :] + flat @ turn.mT
    x, y = grid.points_in_world(position, yaw)
    np.testing.assert_allclose(np.stack([x, y], axis=-1), expected[..., :2], atol=1e-12)
    as_torch = grid.points_in_world(torch.from_numpy(position), torch.from_numpy(yaw))
    np.testing.assert_allclose(np.stack([each.numpy() for each in as_torch]), [x, y], atol=1e-12)
    ahead = rng.normal(size=(2, 5))
    moved = position[..., :2] + ahead[..., None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    np.testing.assert_allclose(
        grid.points_in_world(position, yaw, ahead), grid.points_in_world(moved, yaw), atol=1e-12
    )


@pytest.mark.parametrize(("one", "other"), [(SCAN, LINE), (LINE, FIELD), (FIELD, FIELD)])
def test_a_grid_with_the_points_of_two_finds_those_of_each(
    one: HeightGrid, other: HeightGrid
) -> None:
    both = one.with_points_of(other)
    assert max(one.size, other.size) <= both.size
    for each in (one, other):
        np.testing.assert_allclose(both.points[both.places_of(each)], each.points, atol=1e-9)


def test_places_of_points_that_a_grid_does_not_have_are_refused() -> None:
    assert SCAN_AND_LINE.shape == (45, 11)
    with pytest.raises(ConfigError, match="x of a height grid"):
        SCAN.places_of(LINE)


@pytest.mark.parametrize("grid", [LINE, FIELD], ids=["line", "field"])
def test_a_grid_reads_back_equal_and_has_a_name_of_its_own(grid: HeightGrid) -> None:
    assert HeightGrid.from_toml(grid.to_toml()) == grid
    assert HeightGrid.from_toml(grid.to_toml()).fingerprint == grid.fingerprint
    assert LINE.fingerprint != FIELD.fingerprint


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("x = []", "x of a height grid"),
        ("x = [0.1, 0.1]", "ascend"),
        ("x = [0.0, nan]", "must be a number"),
        ("x = [0.0]\ny = [0.2, 0.1]", "y of a height grid"),
        ("x = [0.0]\nz = [0.0]", "unknown key 'z'"),
        ("x = 1.0", "list"),
        ("x = ", "TOML"),
    ],
)
def test_what_is_no_grid_is_refused(text: str, named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        HeightGrid.from_toml(text)
