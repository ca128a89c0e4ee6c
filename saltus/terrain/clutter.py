"""Ground with things on it: boxes, walls, poles, leaning planks, plates in the air. Not to be crossed, but to be seen.

In some scenes the ground ends, as a desk or a platform does, and goes on lower on one or two levels, which nobody can
know who has not looked over the edge. A predictor that has only ever seen courses is sure of itself anywhere; it learns
here where it does not know.
"""

import math
from collections.abc import Sequence

import numpy as np

from saltus.terrain.boxes import Box
from saltus.terrain.terrain import FIRST_EDGE_X, GROUND_START_X, RUN_OUT, Terrain, across

BOXES = 15
"""At most; with the ground, which is up to three, 18: no more than a course of a training may have."""
FROM_X, TO_X, ASIDE_M = 0.6, 4.5, 0.8
"""Where they are: a camera sees 0.2 m to either side at 1 m, 0.6 m at 3 m."""
SIDE_M = (0.03, 2.0)
"""Of a thing along x and y before it is turned, in equal shares of the logarithm: from a stick to a wall."""
LEAST_HEIGHT_M = 0.03
IN_THE_AIR = 0.3
"""Share of things that have nothing below them, like the plate of a table; they are as often high as low."""
LEANS = 0.4
"""Share of things that lean, as a plank or a heap does."""
LEAN_RAD = 0.8
"""How far they lean at most, to either end: about as steep as rubble lies."""
FINISH_X = TO_X + FIRST_EDGE_X
ENDS = 0.6
"""Share of the scenes whose ground ends: between what a robot sees at first and where the last things are, in equal
shares of the logarithm, as few robots get far."""
DROP_M = (0.1, 1.5)
"""How much lower a level is, in equal shares of the logarithm: from a kerb to a loading dock."""
LEDGE_M = (0.05, 2.0)
"""How far the first of the lower levels goes on, in equal shares of the logarithm. The edge hides much of it: what is
seen of the floor behind says nothing about the ground before it."""


def make(*, height_m: float, rng: np.random.Generator) -> Terrain:
    """Up to `BOXES` things whose tops are up to `height_m` above the ground that they stand on [m]."""
    ground = across(*_levels(rng))
    highest, count = max(height_m, 2.0 * LEAST_HEIGHT_M), int(rng.integers(2, BOXES + 1))
    boxes = [_thing(rng, highest, ground) for _ in range(count)]
    return Terrain(kind="clutter", params={"height_m": height_m}, boxes=(*ground, *boxes), finish_x=FINISH_X)


def _levels(rng: np.random.Generator) -> tuple[list[float], list[float]]:
    """Where the levels of the ground begin and end along x, and their heights [m]."""
    last = FINISH_X + RUN_OUT
    if rng.uniform() >= ENDS:
        return [GROUND_START_X, last], [0.0]
    edge = _spread(rng, (FROM_X, TO_X))
    ledge = edge + _spread(rng, LEDGE_M)
    lower = [-_spread(rng, DROP_M), -_spread(rng, DROP_M)]
    if ledge >= last:
        return [GROUND_START_X, edge, last], [0.0, lower[0]]
    return [GROUND_START_X, edge, ledge, last], [0.0, *lower]


def _thing(rng: np.random.Generator, highest: float, ground: Sequence[Box]) -> Box:
    """Stands on the level at its foremost point."""
    long, wide = _spread(rng, SIDE_M), _spread(rng, SIDE_M)
    top = _spread(rng, (LEAST_HEIGHT_M, highest))
    thick = top
    if rng.uniform() < IN_THE_AIR:
        top, thick = rng.uniform(LEAST_HEIGHT_M, highest), rng.uniform(0.3, 1.0) * LEAST_HEIGHT_M
    pitch = rng.uniform(-LEAN_RAD, LEAN_RAD) if rng.uniform() < LEANS else 0.0
    yaw = rng.uniform(0.0, np.pi)
    level, steep = abs(math.cos(pitch)), abs(math.sin(pitch))
    ahead, up = level * long + steep * thick, steep * long + level * thick
    # Its edge, not its middle, is ahead of where a robot stands at first.
    clear = 0.5 * (abs(math.cos(yaw)) * ahead + abs(math.sin(yaw)) * wide)
    x, y = rng.uniform((FROM_X, -ASIDE_M), (TO_X, ASIDE_M)).tolist()
    floor = next(below.high[2] for below in ground if x <= below.high[0])
    return Box.at((x + clear, y, floor + top - 0.5 * up), (long, wide, thick), pitch=pitch, yaw=yaw)


def _spread(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    """In equal shares of the logarithm."""
    return float(np.exp(rng.uniform(*np.log(bounds))))
