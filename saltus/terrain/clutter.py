"""Ground with things on it: boxes, walls, poles, leaning planks, plates in the air.

Not to be crossed, but to be seen.

In some scenes the ground ends, as a desk or a platform does, and goes on lower, over ledges and
slopes that nobody can know who has not looked over the edge. A predictor that has only ever seen
courses is sure of itself anywhere; it learns here where it does not know.
"""

import math

import numpy as np

from saltus.terrain.boxes import Box
from saltus.terrain.terrain import (
    FIRST_EDGE_X,
    GROUND_START_X,
    RUN_OUT,
    WIDTH,
    Terrain,
    boxes_across,
)

BOXES = 12
"""At most.

With the ground, which is up to six, 18: no more than a course of a training may have.
"""
FROM_X, TO_X, ASIDE_M = 0.6, 4.5, 0.8
"""Where they are: a camera sees 0.2 m to either side at 1 m, 0.6 m at 3 m."""
SIDE_M = (0.03, 2.0)
"""Side of a thing along x and y before it is turned, in equal shares of the logarithm: from a stick
to a wall."""
LEAST_HEIGHT_M = 0.03
IN_THE_AIR = 0.3
"""Share of things that have nothing below them, like the plate of a table.

They are as often high as low.
"""
LEANS = 0.4
"""Share of things that lean, as a plank or a heap does, and of ledges that are slopes."""
LEAN_RAD = 0.8
"""How far they lean at most, to either end: about as steep as rubble lies."""
FINISH_X = TO_X + FIRST_EDGE_X
ENDS = 0.6
"""Share of the scenes whose ground ends."""
EDGE_X = (0.3, 2.0)
"""Where it ends, in equal shares of the logarithm, as few robots get far. It may be before the feet
of a robot that stands at its start: its camera sees the floor behind and never saw the edge."""
DROP_M = (0.1, 1.5)
"""How much lower it goes on: from a kerb to a loading dock."""
LEDGES, LEDGE_M = 4, (0.05, 1.0)
"""At most, before the floor; how far each goes on, in equal shares of the logarithm. The edge hides
much of them: what is seen of the ground behind says little about that before it."""


def make(*, height_m: float, rng: np.random.Generator) -> Terrain:
    """Up to `BOXES` things whose tops are up
    to `height_m` above the ground where robots start [m].
    """
    params = {"height_m": height_m}
    ground = Terrain(kind="clutter", params=params, boxes=_ground(rng), finish_x=FINISH_X)
    highest, count = max(height_m, 2.0 * LEAST_HEIGHT_M), int(rng.integers(2, BOXES + 1))
    things = [_thing(rng, highest, ground) for _ in range(count)]
    return Terrain(kind="clutter", params=params, boxes=(*ground.boxes, *things), finish_x=FINISH_X)


def _ground(rng: np.random.Generator) -> tuple[Box, ...]:
    """As wide as that of a course: the ground where robots start, ledges, the floor."""
    length = FINISH_X + RUN_OUT
    if rng.uniform() >= ENDS:
        return boxes_across([GROUND_START_X, length], [0.0])
    x = _spread(rng, EDGE_X)
    boxes = list(boxes_across([GROUND_START_X, x], [0.0]))
    for _ in range(int(rng.integers(LEDGES + 1))):
        until, top, other = x + _spread(rng, LEDGE_M), -rng.uniform(*DROP_M), -rng.uniform(*DROP_M)
        boxes.append(Box.ramp((x, top), (until, other if rng.uniform() < LEANS else top), WIDTH))
        x = until
    return (*boxes, *boxes_across([x, x + length], [-rng.uniform(*DROP_M)]))


def _thing(rng: np.random.Generator, highest: float, ground: Terrain) -> Box:
    """Stands on what is below its foremost point."""
    x, y = rng.uniform((FROM_X, -ASIDE_M), (TO_X, ASIDE_M)).tolist()
    floor = float(ground.height_at(np.array([x]), np.array([y]))[0])
    highest -= floor
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
    return Box.at((x + clear, y, floor + top - 0.5 * up), (long, wide, thick), pitch=pitch, yaw=yaw)


def _spread(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    """In equal shares of the logarithm."""
    return float(np.exp(rng.uniform(*np.log(bounds))))
