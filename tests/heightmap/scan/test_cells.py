"""Points are sorted into the cells that hold them,
and windows move by whole cells, alike in numpy and in torch.
"""

import numpy as np
import pytest
import torch

from saltus.heightmap.scan import cells
from saltus.heightmap.scan.filling import fill_cells
from saltus.heightmap.scan.settings import MapSettings

SETTINGS = MapSettings(cells=16)
LIBRARIES = pytest.mark.parametrize(
    "library", [np.asarray, torch.from_numpy], ids=["numpy", "torch"]
)


def cloud(batch=2, n=300, seed=0):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.5, 0.5, (batch, n, 3)).astype(np.float32)
    return points, rng.random((batch, n)) < 0.8


@LIBRARIES
def test_a_cell_holds_mean_extremes_and_count_of_its_points(library):
    points, valid = cloud()
    corner = cells.window_corner(np.array([[0.03, 0.0, 0.0], [-0.2, 0.11, 0.0]]), SETTINGS)
    variance = np.full(valid.shape, 1e-4, np.float32)
    found = cells.sorted_into_cells(*map(library, (points, variance, valid, corner)), SETTINGS)
    side, fine = SETTINGS.side, SETTINGS.fine_m
    for robot in range(len(points)):
        cell = np.floor(points[robot, :, :2] / fine).astype(int) - corner[robot] * SETTINGS.sub
        inside = valid[robot] & (cell >= 0).all(1) & (cell < side).all(1)
        assert float(found.count[robot].sum()) == inside.sum()
        for i, j in {tuple(c) for c in cell[inside]}:
            z = points[robot, inside & (cell == (i, j)).all(1), 2]
            assert float(found.mean[robot, i, j]) == pytest.approx(z.mean(), abs=1e-6)
            assert float(found.high[robot, i, j]) == z.max()
            assert float(found.low[robot, i, j]) == z.min()


@LIBRARIES
def test_a_moved_window_keeps_every_value_at_its_place(library):
    rng = np.random.default_rng(1)
    values = rng.random((3, 8, 8)).astype(np.float32)
    by = np.array([[0, 0], [3, -2], [-9, 0]])
    found = np.asarray(cells.move_window(library(values), library(by), -1.0))
    for robot, (di, dj) in enumerate(by):
        for i in range(8):
            for j in range(8):
                inside = 0 <= i + di < 8 and 0 <= j + dj < 8
                assert found[robot, i, j] == (values[robot, i + di, j + dj] if inside else -1.0)


@LIBRARIES
def test_a_plane_is_read_where_it_is(library):
    corner = np.array([[-8, 3], [40, -20]])
    x, y = cells.cell_centres(library(corner), SETTINGS, library(np.zeros((2, 1))))
    plane = 0.3 * x - 0.2 * y + 1.0
    rng = np.random.default_rng(2)
    inner = rng.uniform(0.03, 0.60, (2, 50, 2)) + corner[:, None] * SETTINGS.cell_m
    found = cells.sample_bilinear(
        plane, cells.fine_cell_positions(library(inner), library(corner), SETTINGS)
    )
    np.testing.assert_allclose(found, 0.3 * inner[..., 0] - 0.2 * inner[..., 1] + 1.0, atol=1e-9)


@LIBRARIES
def test_filling_keeps_what_is_known_and_stays_within_it(library):
    rng = np.random.default_rng(3)
    height, known = rng.normal(size=(2, 32, 32)), (rng.random((2, 32, 32)) < 0.1).astype(float)
    found = np.asarray(fill_cells(library(height), library(known)))
    np.testing.assert_allclose(found[known > 0], height[known > 0])
    for robot in range(2):
        mine = height[robot][known[robot] > 0]
        assert mine.min() - 1e-9 <= found[robot].min()
        assert found[robot].max() <= mine.max() + 1e-9


@LIBRARIES
def test_one_known_height_fills_everything(library):
    height, known = np.full((1, 16, 16), 7.0), np.zeros((1, 16, 16))
    height[0, 3, 5], known[0, 3, 5] = 0.25, 1.0
    np.testing.assert_allclose(
        np.asarray(fill_cells(library(height), library(known))), 0.25, atol=1e-6
    )
