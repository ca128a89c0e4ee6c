"""Terrains of boxes that are turned anyhow, on ground that may be turned too."""

import numpy as np

from saltus.terrain.boxes import Box
from saltus.terrain.terrain import Terrain

COUNT = 30
REACH_X, REACH_Y = (-2.0, 6.0), (-2.0, 2.0)


def random_terrain(seed: int) -> Terrain:
    rng = np.random.default_rng(seed)
    ground = Box.at((2.0, 0.0, -0.5), (8.0, 4.0, 1.0), pitch=float(rng.choice([0.0, 0.05])))
    boxes = [ground]
    for kind in rng.integers(0, 4, COUNT):
        center = [rng.uniform(*REACH_X), rng.uniform(*REACH_Y), rng.uniform(-0.2, 0.4)]
        pitch = float(rng.uniform(-1.0, 1.0)) if kind in (1, 3) else 0.0
        yaw = float(rng.uniform(-np.pi, np.pi)) if kind in (2, 3) else 0.0
        boxes.append(Box.at(center, rng.uniform(0.1, 1.0, 3), pitch, yaw))
    return Terrain(kind="boxes", boxes=tuple(boxes), finish_x=5.0)


def places(terrain: Terrain, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Where a small step to any side changes the height by little:
    at an edge either side is right.
    """
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(*REACH_X, 4 * count), rng.uniform(*REACH_Y, 4 * count)
    step = 1e-4
    around = [
        terrain.height_at(x + a, y + b)
        for a, b in ((step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step))
    ]
    is_smooth = np.max(np.abs(np.array(around) - terrain.height_at(x, y)), axis=0) < 10.0 * step
    return x[is_smooth][:count], y[is_smooth][:count]
