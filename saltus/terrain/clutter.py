"""Level ground with things on it at random: boxes, walls, poles, plates in the air. Not to be crossed, but to be seen.

A predictor that has only ever seen courses is sure of itself anywhere; it learns here where it does not know.
"""

import math

import numpy as np

from saltus.terrain.boxes import Box
from saltus.terrain.terrain import FIRST_EDGE_X, GROUND_START_X, RUN_OUT, Terrain, across

BOXES = 16
"""At most; with the ground 17, fewer than a course of a training may have."""
FROM_X, TO_X, ASIDE_M = 0.6, 4.5, 0.8
"""Where they are: a camera sees 0.2 m to either side at 1 m, 0.6 m at 3 m."""
SIDE_M = (0.03, 2.0)
"""Of a thing along x and y before it is turned, in equal shares of the logarithm: from a stick to a wall."""
LEAST_HEIGHT_M = 0.03
IN_THE_AIR = 0.3
"""Share of things that have nothing below them, like the plate of a table; they are as often high as low."""
FINISH_X = TO_X + FIRST_EDGE_X


def make(*, height_m: float, rng: np.random.Generator) -> Terrain:
    """Up to `BOXES` things whose tops are up to `height_m` high [m]."""
    boxes = [_thing(rng, max(height_m, 2.0 * LEAST_HEIGHT_M)) for _ in range(int(rng.integers(2, BOXES + 1)))]
    ground = across((GROUND_START_X, FINISH_X + RUN_OUT), (0.0,))
    return Terrain(kind="clutter", params={"height_m": height_m}, boxes=(*ground, *boxes), finish_x=FINISH_X)


def _thing(rng: np.random.Generator, highest: float) -> Box:
    long, wide = np.exp(rng.uniform(np.log(SIDE_M[0]), np.log(SIDE_M[1]), 2)).tolist()
    top = float(np.exp(rng.uniform(np.log(LEAST_HEIGHT_M), np.log(highest))))
    thick = top
    if rng.uniform() < IN_THE_AIR:
        top, thick = rng.uniform(LEAST_HEIGHT_M, highest), rng.uniform(0.3, 1.0) * LEAST_HEIGHT_M
    yaw = rng.uniform(0.0, np.pi)
    # Its edge, not its middle, is ahead of where a robot stands at first.
    clear = 0.5 * (abs(math.cos(yaw)) * long + abs(math.sin(yaw)) * wide)
    x, y = rng.uniform((FROM_X, -ASIDE_M), (TO_X, ASIDE_M)).tolist()
    return Box.at((x + clear, y, top - 0.5 * thick), (long, wide, thick), yaw=yaw)
