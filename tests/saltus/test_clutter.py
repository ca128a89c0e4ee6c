"""Scenes that are no course."""

from itertools import pairwise

import numpy as np
import pytest

from saltus.config import TerrainConfig
from saltus.terrain.clutter import BOXES, DROP_M, FROM_X
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain, checked


@pytest.mark.parametrize("difficulty", [0.0, 0.5, 1.0])
def test_robots_start_clear_of_what_stands_about(difficulty: float) -> None:
    """Up to as high as asked for; some ground ends and goes on lower; another layout is another scene."""
    drawn = [make_terrain(TerrainConfig(terrain="clutter", difficulty=difficulty, layout_seed=i)) for i in range(40)]
    for terrain, other in pairwise(drawn):
        assert checked(terrain, "clutter").boxes != other.boxes
        x, y = np.meshgrid(np.linspace(-1.5, terrain.finish_x, 300), np.linspace(-1.0, 1.0, 21))
        height = np.asarray(terrain.height_at(x.ravel(), y.ravel()))
        assert (height[x.ravel() <= FROM_X] == 0.0).all()
        assert height.max() <= terrain.params["height_m"] + 1e-9
        edge, drop = ground_end(terrain)
        on, beyond = height[x.ravel() <= edge], height[x.ravel() > edge]
        assert on.min() == 0.0
        assert not len(beyond) or beyond.min() == pytest.approx(-drop)
        assert len(beyond) or height.max() > 0.0
        assert len(terrain.boxes) <= (2 if drop else 1) + BOXES
    drops = np.array([ground_end(terrain)[1] for terrain in drawn])
    assert 0.1 < (drops > 0.0).mean() < 0.7
    assert (drops[drops > 0.0] >= DROP_M[0]).all()
    assert (drops <= DROP_M[1]).all()


def ground_end(terrain: Terrain) -> tuple[float, float]:
    """Where level ground ends, and how much lower it goes on: 0 where it goes on as it is."""
    first, second = terrain.boxes[:2]
    lower = second.low[0] == first.high[0] and second.low[1] == first.low[1]
    return first.high[0], -second.high[2] if lower else 0.0
