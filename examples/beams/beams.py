"""Beams that lie across level ground, each turned a little: a family of terrain of one's own."""

import numpy as np

from saltus.terrain.boxes import Box
from saltus.terrain.terrain import Terrain

COUNT = 5


def make(difficulty: float, rng: np.random.Generator) -> Terrain:
    """Five beams, from 0.04 m high at difficulty 0 to 0.24 m at 1.

    Where they lie, and how, is drawn.

    World frame: x ahead, y to the left, z up [m]; the robot starts at x = 0 on ground that is at z
    = 0 there.
    """
    height = 0.04 + 0.20 * difficulty
    x = 0.5 + np.cumsum(rng.uniform(0.9, 1.5, COUNT))
    ground = Box(low=(-2.0, -2.0, -1.0), high=(float(x[-1]) + 5.0, 2.0, 0.0))
    beams = [
        Box.at((at, 0.0, 0.5 * height), (0.12, 3.0, height), yaw=rng.uniform(-0.3, 0.3))
        for at in x.tolist()
    ]
    return Terrain(kind="beams", boxes=(ground, *beams), finish_x=float(x[-1]) + 1.0)
