"""Stairs up to a platform."""

from saltus.terrain.terrain import FINISH_AFTER_COURSE, Terrain, build


def make(*, steps: int, rise_m: float, run_m: float) -> Terrain:
    """Ascending stairs; the last of the `steps` risers leads onto a platform."""
    return build(
        "stairs",
        {"steps": steps, "rise_m": rise_m, "run_m": run_m},
        [(run_m, rise_m * step) for step in range(1, steps)],
        last_top=rise_m * steps,
        finish_behind=FINISH_AFTER_COURSE,
    )
