"""Scenes unlike any course: tables, clutter of boxes,
steps across the view, poles, all on level ground.
"""

from collections.abc import Callable, Iterable

import numpy as np

from saltus.terrain.boxes import Box
from saltus.terrain.terrain import Terrain, boxes_across

ENDS_M = (-2.0, 8.0)
FINISH_X = 6.0
FIRST_M, LAST_M, ASIDE_M = 0.8, 4.0, 0.6
"""Where things stand: the robot starts at 0 and looks 0.5 to 3 m ahead, 0.2 m to either side at 1
m."""
_DEG = np.pi / 180.0


def tables(rng: np.random.Generator) -> Iterable[Box]:
    """Two tables: plates of which one sees the upper or the lower side, on four legs."""
    for first in (0.9, 2.6):
        long, wide, high = rng.uniform(0.5, 1.0), rng.uniform(0.7, 1.6), rng.uniform(0.35, 0.8)
        x, y, yaw = (
            first + 0.5 * long + rng.uniform(0.0, 0.5),
            rng.uniform(-0.4, 0.4),
            rng.uniform(-0.5, 0.5),
        )
        thick, leg = rng.uniform(0.02, 0.05), rng.uniform(0.04, 0.08)
        yield Box.at((x, y, high - 0.5 * thick), (long, wide, thick), yaw=yaw)
        for ahead, aside in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            off = 0.5 * np.array([ahead * (long - leg), aside * (wide - leg)])
            turned = (
                np.cos(yaw) * off[0] - np.sin(yaw) * off[1],
                np.sin(yaw) * off[0] + np.cos(yaw) * off[1],
            )
            upright = 0.5 * (high - thick)
            yield Box.at(
                (x + turned[0], y + turned[1], upright), (leg, leg, 2.0 * upright), yaw=yaw
            )


def clutter(rng: np.random.Generator) -> Iterable[Box]:
    """Boxes like those of a store room, turned anyhow."""
    for _ in range(12):
        size = rng.uniform((0.15, 0.15, 0.08), (0.6, 0.6, 0.5))
        yield _standing(rng, size, yaw=rng.uniform(0.0, np.pi))


def steps_across(rng: np.random.Generator) -> Iterable[Box]:
    """A stair of three steps whose edges are 20 to 60 degrees askew to the way,
    from the right or from the left.
    """
    yaw = rng.uniform(20.0, 60.0) * _DEG * rng.choice((-1.0, 1.0))
    rise, tread, x = rng.uniform(0.08, 0.22), rng.uniform(0.25, 0.5), rng.uniform(1.2, 1.8)
    for i in range(3):
        half = 2.0
        ahead = half + i * tread
        center = (x + ahead * np.cos(yaw), ahead * np.sin(yaw), 0.5 * rise * (i + 1))
        yield Box.at(center, (2.0 * half, 6.0, rise * (i + 1)), yaw=yaw)


def poles(rng: np.random.Generator) -> Iterable[Box]:
    """Upright poles, from a broomstick to a post."""
    for _ in range(10):
        side = rng.uniform(0.03, 0.12)
        yield _standing(rng, (side, side, rng.uniform(0.4, 1.5)), yaw=rng.uniform(0.0, np.pi))


SCENES: dict[str, Callable[[np.random.Generator], Iterable[Box]]] = {
    "tables": tables,
    "clutter of boxes": clutter,
    "steps across": steps_across,
    "poles": poles,
}


def scene(name: str, rng: np.random.Generator) -> Terrain:
    """One of `SCENES`, drawn."""
    ground = boxes_across(ENDS_M, (0.0,))
    return Terrain(kind=name, boxes=(*ground, *SCENES[name](rng)), finish_x=FINISH_X)


def _standing(rng: np.random.Generator, size: Iterable[float], yaw: float) -> Box:
    long, wide, high = size
    place = rng.uniform((FIRST_M, -ASIDE_M), (LAST_M, ASIDE_M))
    return Box.at((*place.tolist(), 0.5 * high), (long, wide, high), yaw=yaw)
