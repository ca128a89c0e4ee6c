"""Stairs up to a platform."""

import numpy as np

from saltus.terrain.terrain import FINISH_AFTER_COURSE, Terrain, build


def make(*, steps: int, rise_m: float, run_m: float) -> Terrain:
    """Ascending stairs; the last of the `steps` risers leads onto a platform."""
    return build(
        "stairs",
        {"steps": steps, "rise_m": rise_m, "run_m": run_m},
        widths=[run_m] * (steps - 1),
        tops=list(rise_m * np.arange(1, steps)),
        last_top=rise_m * steps,
        finish_behind=FINISH_AFTER_COURSE,
    )
