"""A policy's observation of heights is the one that its own project computes,
on ground that is drawn.

Each project's arithmetic is written here as its page describes it, from ray hits or a sampled
terrain in the world; Saltus's starts from heights relative to the base in the order of its grid.
"""

import numpy as np
import pytest
import torch

from saltus.dialects import DIALECTS, Dialect, dialect_of
from saltus.errors import ConfigError
from saltus.grid import SCAN, HeightGrid
from saltus.terrain import clutter

UNEVEN = HeightGrid(x=(-0.3, 0.1, 0.2, 0.6), y=(-0.2, 0.0, 0.5))


def in_world(x, y, base, yaw):
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return base[0] + cosine * x - sine * y, base[1] + sine * x + cosine * y


def isaaclab(ground, base, yaw, grid):
    """Rays of its grid pattern ("xy": x runs first), turned by the yaw;
    sensor height - hit - 0.5, clipped at 1.
    """
    x, y = np.meshgrid(grid.x, grid.y, indexing="xy")
    hits = ground(*in_world(x.ravel(), y.ravel(), base, yaw))
    return np.clip(base[2] - hits - 0.5, -1.0, 1.0)


def legged_gym(ground, base, yaw, grid):
    """Points of a mesh that runs along y first.

    Root height - 0.5 - measured, clipped at 1, times 5.
    """
    x, y = np.meshgrid(grid.x, grid.y, indexing="ij")
    measured = ground(*in_world(x.ravel(), y.ravel(), base, yaw))
    return np.clip(base[2] - 0.5 - measured, -1.0, 1.0) * 5.0


def mjlab(ground, base, yaw, grid):
    """Rays of its grid pattern, x first; sensor height - hit, by the 5 m of the sensor.

    Nothing is clipped.
    """
    x, y = np.meshgrid(grid.x, grid.y, indexing="xy")
    hits = ground(*in_world(x.ravel(), y.ravel(), base, yaw))
    return (base[2] - hits) / 5.0


PROJECTS = {"isaaclab": isaaclab, "legged_gym": legged_gym, "mjlab": mjlab}


@pytest.mark.parametrize("library", [np.asarray, torch.from_numpy], ids=["numpy", "torch"])
@pytest.mark.parametrize("grid", [SCAN, UNEVEN], ids=["scan", "uneven"])
@pytest.mark.parametrize("name", DIALECTS)
def test_a_policy_reads_what_its_project_computes(name, grid, library):
    rng = np.random.default_rng(7)
    terrain = clutter.make(height_m=0.6, rng=rng)
    spread = []
    for _ in range(20):
        base, yaw = (
            np.array([*rng.uniform(-1.0, 3.0, 2), rng.uniform(0.2, 2.2)]),
            rng.uniform(-np.pi, np.pi),
        )
        x, y = grid.points_in_world(base[:2], np.asarray(yaw))
        height = terrain.height_at(x, y) - base[2]
        found = np.asarray(dialect_of(name).observation(library(height), grid))
        np.testing.assert_allclose(
            found, PROJECTS[name](terrain.height_at, base, yaw, grid), atol=1e-12
        )
        spread.append(found.std())
    assert max(spread) > 0.0


@pytest.mark.parametrize("dialect", DIALECTS.values(), ids=DIALECTS)
def test_a_batch_is_read_as_each_of_it(dialect):
    heights = np.random.default_rng(0).normal(size=(2, 3, SCAN.size))
    each = np.stack([[dialect.observation(row, SCAN) for row in rows] for rows in heights])
    np.testing.assert_array_equal(dialect.observation(heights, SCAN), each)


def test_every_project_has_a_dialect_and_reads_back_equal():
    assert PROJECTS.keys() == DIALECTS.keys()
    for dialect in DIALECTS.values():
        assert Dialect.from_toml(dialect.to_toml()) == dialect


def test_what_does_not_fit_is_refused():
    with pytest.raises(ConfigError, match=r"186 heights.*187 points"):
        DIALECTS["mjlab"].observation(np.zeros(186), SCAN)
    with pytest.raises(ConfigError, match="isaaclab"):
        dialect_of("isaac_lab")
    for changes in (
        {"outer_axis": "z"},
        {"outer_axis": "x", "clip_m": -1.0},
        {"outer_axis": "x", "scale": float("nan")},
    ):
        with pytest.raises(ConfigError, match=list(changes)[-1]):
            Dialect(**changes)
