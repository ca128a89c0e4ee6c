"""Stones with trenches between them."""

import numpy as np

from saltus.errors import ConfigError
from saltus.terrain.terrain import FINISH_AFTER_COURSE, TRENCH_DEPTH, Terrain, build


def make(
    *,
    steps: int,
    stone_m: float,
    gap_m: float,
    gap_max_m: float | None = None,
    rng: np.random.Generator | None = None,
) -> Terrain:
    """A trench before each of the `steps` stones and one behind the last; all tops are level.

    Args:
        steps: Number of stones.
        stone_m: Length of a stone along the course [m].
        gap_m: Width of every trench [m]; the least width where `gap_max_m` is given.
        gap_max_m: Greatest width [m]: each trench is then drawn uniformly from [`gap_m`, `gap_max_m`].
        rng: Source of those widths.

    Raises:
        ConfigError: `gap_max_m` is given without a generator, or is less than `gap_m`.
    """
    params = {"steps": steps, "stone_m": stone_m, "gap_m": gap_m}
    gaps = np.full(steps + 1, gap_m)
    if gap_max_m is not None:
        if rng is None or gap_max_m < gap_m:
            raise ConfigError(f"gap_max_m = {gap_max_m} needs a random generator and must be at least gap_m = {gap_m}")
        gaps = rng.uniform(gap_m, gap_max_m, steps + 1)
        params["gap_max_m"] = gap_max_m
    columns = [(float(gaps[0]), -TRENCH_DEPTH)]
    for gap in gaps[1:]:
        columns += [(stone_m, 0.0), (float(gap), -TRENCH_DEPTH)]
    return build(
        "stepping_stones",
        params,
        columns,
        last_top=0.0,
        finish_behind=FINISH_AFTER_COURSE,
    )
