"""One course of level columns, by its sizes."""

import numpy as np

from saltus.errors import ConfigError
from saltus.terrain.course_law import KINDS, course_shape, scale_draw
from saltus.terrain.terrain import (
    FINISH_AFTER_COURSE,
    FINISH_AFTER_SINGLE,
    TRENCH_DEPTH,
    Terrain,
    build_course,
)

SINGLE = ("step", "step_down", "gap", "ditch")
"""Kinds with one edge or one trench."""
_COLUMNS = {"stepping_stones": (1, 1), "pyramid": (2, 0), "hurdles": (2, 0)}
"""For each of its `steps`, and besides: a trench behind the last stone, stairs up and down, hurdles
and ground."""


def make(kind: str, rng: np.random.Generator | None = None, **sizes: float) -> Terrain:
    """A course of a kind of `saltus.terrain.course_law`, of any but flat ground.

    Args:
        kind: Its name.
        rng: Source of what is drawn: widths and depth of trenches where a greatest is given,
            irregular stairs.
        sizes: Those of `saltus.config.TerrainConfig` that the kind has, by their names [m].

    Raises:
        ConfigError: a greatest size is less than the least.
    """
    each, besides = _COLUMNS.get(kind, (1, 0))
    count = each * int(sizes.get("steps", 1)) + besides
    rise = sizes.get("rise_m", sizes.get("height_m", 0.0)) * (
        -1.0 if kind.endswith("_down") else 1.0
    )
    gap, depth = _bounds(sizes, "gap", 0.0), _bounds(sizes, "depth", TRENCH_DEPTH)
    one = np.ones(1)
    *of_columns, of_depth = (rng or np.random.default_rng(0)).uniform(size=count + 1)
    columns = course_shape(
        np.array([KINDS.index(kind)]),
        count=count * one,
        rise=rise * one,
        length=sizes.get("run_m", sizes.get("stone_m", 0.0)) * one,
        gap=(gap[0] * one, gap[1] * one),
        depth=scale_draw(depth, of_depth) * one,
        draws=np.array([[0.0, *of_columns]]),
    )
    rows = zip(columns.gap[0, 1:], columns.length[0, 1:], columns.top[0, 1:], strict=True)
    parts = [part for gap, length, top in rows for part in ((gap, columns.floor[0]), (length, top))]
    return build_course(
        kind, sizes, parts[:-1], last_top=parts[-1][1],
        finish_behind=FINISH_AFTER_SINGLE if kind in SINGLE else FINISH_AFTER_COURSE,
    )  # fmt: skip


def _bounds(sizes: dict[str, float], name: str, otherwise: float) -> tuple[float, float]:
    """Least and greatest of a size; one number where no greatest is given."""
    least = sizes.get(f"{name}_m", otherwise)
    greatest = sizes.get(f"{name}_max_m", least)
    if greatest < least:
        raise ConfigError(f"{name}_max_m = {greatest}: it must be at least {name}_m = {least}")
    return least, greatest
