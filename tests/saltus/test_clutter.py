"""Scenes that are no course."""

from itertools import pairwise

import numpy as np
import pytest

from saltus.config import TerrainConfig
from saltus.terrain.boxes import Box
from saltus.terrain.clutter import BOXES, DROP_M, FROM_X, LEAN_RAD, LEANS, LEDGE_M
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain, checked


@pytest.mark.parametrize("difficulty", [0.0, 0.5, 1.0])
def test_robots_start_clear_of_what_stands_about(difficulty: float) -> None:
    """Up to as high as asked for; some ground ends and goes on lower; another layout is another scene."""
    drawn = [make_terrain(TerrainConfig(terrain="clutter", difficulty=difficulty, layout_seed=i)) for i in range(80)]
    for terrain, other in pairwise(drawn):
        assert checked(terrain, "clutter").boxes != other.boxes
        x, y = np.meshgrid(np.linspace(-1.5, terrain.finish_x, 300), np.linspace(-1.0, 1.0, 21))
        height = np.asarray(terrain.height_at(x.ravel(), y.ravel()))
        assert (height[x.ravel() <= FROM_X] == 0.0).all()
        assert height.max() <= terrain.params["height_m"] + 1e-9
        levels = levels_of(terrain)
        for level in levels:
            on = height[(x.ravel() > level.low[0]) & (x.ravel() <= level.high[0])]
            assert not len(on) or on.min() == pytest.approx(level.high[2])
        assert len(levels) > 1 or height.max() > 0.0
        assert len(terrain.boxes) <= len(levels) + BOXES
    pitches = np.array([box.pitch for terrain in drawn for box in terrain.boxes])
    assert (abs(pitches) <= LEAN_RAD).all()
    assert 0.2 < np.mean(pitches != 0.0) < LEANS  # the ground is level
    lower = [levels_of(terrain)[1:] for terrain in drawn]
    assert 0.1 < np.mean([len(levels) > 0 for levels in lower]) < 0.7
    drops = -np.array([level.high[2] for levels in lower for level in levels])
    assert (drops >= DROP_M[0]).all()
    assert (drops <= DROP_M[1]).all()
    ledges = np.array([levels[0].high[0] - levels[0].low[0] for levels in lower if len(levels) == 2])
    assert (ledges >= LEDGE_M[0]).all()
    assert (ledges <= LEDGE_M[1]).all()
    assert 0.1 < len(ledges) / len(drawn) < 0.7


def levels_of(terrain: Terrain) -> list[Box]:
    """The levels of the ground, one after the other along x."""
    return [box for box in terrain.boxes if box.high[1] == terrain.boxes[0].high[1] and box.yaw == 0.0]
