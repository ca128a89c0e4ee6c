"""One trench."""

from saltus.terrain.terrain import FINISH_AFTER_SINGLE, TRENCH_DEPTH, Terrain, build


def make(*, gap_m: float) -> Terrain:
    """A trench `gap_m` wide and 0.4 m deep, with a floor."""
    return build(
        "gap",
        {"gap_m": gap_m},
        [(gap_m, -TRENCH_DEPTH)],
        last_top=0.0,
        finish_behind=FINISH_AFTER_SINGLE,
    )
