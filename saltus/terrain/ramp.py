"""A slope between two levels."""

import math
from dataclasses import replace

from saltus.terrain.boxes import Box
from saltus.terrain.terrain import FINISH_AFTER_COURSE, FIRST_EDGE_X, WIDTH, Terrain, build_course


def make(kind: str, *, slope_deg: float, run_m: float) -> Terrain:
    """A slope of an angle [deg] and a length along x [m] that leads up, or down where `kind` is
    "ramp_down".
    """
    up = run_m * math.tan(math.radians(slope_deg)) * (-1.0 if kind == "ramp_down" else 1.0)
    sizes = {"slope_deg": slope_deg, "run_m": run_m}
    level = build_course(
        kind, sizes, [(run_m, min(up, 0.0))], last_top=up, finish_behind=FINISH_AFTER_COURSE
    )
    slope = Box.ramp((FIRST_EDGE_X, 0.0), (FIRST_EDGE_X + run_m, up), WIDTH)
    return replace(level, boxes=(*level.boxes[:2], slope, *level.boxes[2:]))
