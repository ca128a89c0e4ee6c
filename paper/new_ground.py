"""Ground that no training has: stairs of planks, stairs with noses, several obstacles in a row."""

import numpy as np

from saltus.terrain.boxes import Box
from saltus.terrain.terrain import (
    BOTTOM,
    FINISH_AFTER_COURSE,
    FIRST_EDGE_X,
    GROUND_START_X,
    RUN_OUT,
    WIDTH,
    Terrain,
)


def plank_stairs(
    steps: int = 14, rise: float = 0.20, run: float = 0.25, plank: float = 0.04
) -> Terrain:
    """Stairs of planks with nothing between them, which cameras look through."""
    edges = FIRST_EDGE_X + run * np.arange(steps)
    top, end = steps * rise, float(edges[-1]) + FINISH_AFTER_COURSE + RUN_OUT
    half = 0.5 * WIDTH
    boxes = [Box(low=(GROUND_START_X, -half, BOTTOM), high=(end, half, 0.0))]
    for i, x in enumerate(edges[:-1].tolist(), 1):
        boxes.append(Box(low=(x, -half, i * rise - plank), high=(x + run, half, i * rise)))
    boxes.append(Box(low=(float(edges[-1]), -half, top - plank), high=(end, half, top)))
    finish = float(edges[-1]) + FINISH_AFTER_COURSE
    return Terrain(kind="plank stairs", boxes=tuple(boxes), finish_x=finish)


def nosed_stairs(
    steps: int = 14, rise: float = 0.17, run: float = 0.28, nose: float = 0.03
) -> Terrain:
    """Stairs of a house, whose treads stand out over the risers below them."""
    half, edges = 0.5 * WIDTH, FIRST_EDGE_X + run * np.arange(steps)
    end = float(edges[-1]) + FINISH_AFTER_COURSE + RUN_OUT
    boxes = [Box(low=(GROUND_START_X, -half, BOTTOM), high=(float(edges[0]) + nose, half, 0.0))]
    for i, x in enumerate(edges.tolist(), 1):
        back = end if i == steps else x + run
        boxes.append(
            Box(
                low=(x + nose, -half, BOTTOM),
                high=(back + (nose if i < steps else 0), half, i * rise - 0.03),
            )
        )
        boxes.append(Box(low=(x, -half, i * rise - 0.03), high=(back, half, i * rise)))
    return Terrain(
        kind="nosed stairs", boxes=tuple(boxes), finish_x=float(edges[-1]) + FINISH_AFTER_COURSE
    )


def mixed_course() -> Terrain:
    """Six stairs, a landing, a gap, a step and three stones in a row."""
    ends, tops = [GROUND_START_X, FIRST_EDGE_X], [0.0]
    parts = [
        *((0.25, 0.2 * i) for i in range(1, 6)),
        (1.5, 1.2),
        (0.5, -0.4),
        (1.5, 1.2),
        (1.5, 1.6),
    ]
    parts += [(0.3, -0.4), (0.5, 1.6), (0.3, -0.4), (0.5, 1.6), (0.3, -0.4)]
    for length, top in parts:
        ends.append(ends[-1] + length)
        tops.append(top)
    finish = ends[-1] + FINISH_AFTER_COURSE
    ends.append(finish + RUN_OUT)
    half = 0.5 * WIDTH
    boxes = tuple(
        Box(low=(low, -half, BOTTOM), high=(high, half, top))
        for low, high, top in zip(ends[:-1], ends[1:], [*tops, 1.6], strict=True)
    )
    return Terrain(kind="stairs, gap, step and stones", boxes=boxes, finish_x=finish)


NEW_GROUND = {
    "stairs of planks": plank_stairs,
    "stairs with noses": nosed_stairs,
    "stairs, gap, step and stones in a row": mixed_course,
}
"""Not one of them is in the training of policy or predictor."""
