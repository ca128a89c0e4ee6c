"""Scenes that are no course."""

from itertools import pairwise

import numpy as np
import pytest

from saltus.config import TerrainConfig
from saltus.terrain.boxes import Box
from saltus.terrain.clutter import BOXES, DROP_M, EDGE_X, FROM_X, LEAN_RAD, LEDGE_M, LEDGES
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import WIDTH, Terrain, check_terrain


@pytest.mark.sample(1)
@pytest.mark.parametrize("difficulty", [0.0, 0.5, 1.0])
def test_robots_start_clear_of_what_stands_about(difficulty: float) -> None:
    """Up to as high as asked for; some ground ends; another layout is another scene."""
    drawn = [
        make_terrain(TerrainConfig(terrain="clutter", difficulty=difficulty, layout_seed=i))
        for i in range(80)
    ]
    for terrain, other in pairwise(drawn):
        assert check_terrain(terrain, "clutter").boxes != other.boxes
        x, y = np.meshgrid(np.linspace(-1.5, terrain.finish_x, 300), np.linspace(-1.0, 1.0, 21))
        height = np.asarray(terrain.height_at(x.ravel(), y.ravel()))
        ground, *lower = ground_of(terrain)
        edge = ground.high[0]
        assert (height[x.ravel() <= min(FROM_X, edge)] == 0.0).all()
        assert height.max() <= terrain.params["height_m"] + 1e-9
        assert height.min() >= -DROP_M[1] - 1e-9
        assert bool(lower) == (edge < terrain.finish_x)
        assert not lower or edge >= EDGE_X[0]
        assert lower or height.max() > 0.0
        assert len(terrain.boxes) <= 1 + len(lower) + BOXES
    pitches = np.array(
        [box.pitch for terrain in drawn for box in terrain.boxes[len(ground_of(terrain)) :]]
    )
    assert (abs(pitches) <= LEAN_RAD).all()
    assert 0.3 < np.mean(pitches != 0.0) < 0.5


@pytest.mark.parametrize("seed", range(3))
def test_where_the_ground_ends_nothing_tells_what_follows(seed: int) -> None:
    """All of it is lower; ledges are long and short, level and steep."""
    drawn = [
        make_terrain(TerrainConfig(terrain="clutter", layout_seed=1000 * seed + i))
        for i in range(80)
    ]
    lower = [ground_of(terrain)[1:] for terrain in drawn]
    assert 0.4 < np.mean([len(boxes) > 0 for boxes in lower]) < 0.8
    assert {len(boxes) for boxes in lower} == {0, *range(1, LEDGES + 2)}
    for terrain in drawn:
        boxes = ground_of(terrain)
        x = np.linspace(min(boxes[0].high[0], terrain.finish_x), terrain.finish_x, 200)[1:-1]
        ground = Terrain(kind="clutter", params={}, boxes=tuple(boxes), finish_x=terrain.finish_x)
        height = np.asarray(ground.height_at(x, np.zeros_like(x)))
        assert (height <= (-DROP_M[0] + 1e-9 if len(boxes) > 1 else 0.0)).all()
        assert (height >= -DROP_M[1] - 1e-9).all()
    ledges = [box for boxes in lower for box in boxes[:-1]]
    ahead = np.array([(box.high[0] - box.low[0]) * np.cos(box.pitch) for box in ledges])
    assert (ahead >= LEDGE_M[0] - 1e-9).all()
    assert (ahead <= LEDGE_M[1] + 1e-9).all()
    assert 0.2 < np.mean(ahead < np.sqrt(np.prod(LEDGE_M))) < 0.8
    assert 0.2 < np.mean([box.pitch != 0.0 for box in ledges]) < 0.6
    assert max(abs(box.pitch) for box in ledges) > LEAN_RAD


def ground_of(terrain: Terrain) -> list[Box]:
    """What is as wide as a course, one after the other along x; slopes have no level upper face."""
    return [
        box
        for box in terrain.boxes
        if box.high[1] == WIDTH / 2.0 and box.low[1] == -WIDTH / 2.0 and box.yaw == 0.0
    ]
