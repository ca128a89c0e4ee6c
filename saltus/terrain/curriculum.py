"""From a configuration to a terrain: explicit sizes, else sizes from the difficulty, else defaults; or from a file."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np

from saltus.config import TerrainConfig, TerrainKind, load
from saltus.errors import ConfigError, nearest_hint
from saltus.terrain import flat, gap, stairs, step, stepping_stones
from saltus.terrain.terrain import Terrain

FILE_SUFFIX = ".toml"
LEVEL_M = 1e-3
"""What the ground at the start of a course from a file may be off zero: a robot starts upon it."""
SIZES = ("steps", "rise_m", "run_m", "stone_m", "gap_m", "height_m")


@dataclass(frozen=True, kw_only=True)
class Size:
    """One size of a kind of terrain: its default, its bounds, and how difficulty sets it."""

    default: float
    low: float
    high: float
    slope: float = 0.0
    """Growth of the size from difficulty 0 to 1."""
    base: float | None = None
    """The size at difficulty 0; None where difficulty does not set it."""

    def resolve(self, name: str, value: float | None, difficulty: float | None) -> float:
        """The size to use: `value`, else what `difficulty` makes of it, else the default."""
        if value is None:
            if difficulty is None or self.base is None:
                return self.default
            return self.base + self.slope * difficulty
        if not self.low <= value <= self.high:
            raise ConfigError(f"{name} = {value} is out of range: it must be from {self.low:g} to {self.high:g}")
        return value


# The laws of difficulty are the project's definition (the original's, with gap and step widened so that difficulty 1
# is beyond the paper's best jumps of 0.8 m and 0.6 m). Defaults: the courses of the paper's robot, with the mean of its
# gaps between stones. Bounds: the least that a foot of 4 cm can tell from flat ground or stand on, up to a quarter more
# than difficulty 1 asks for.
TABLE: dict[TerrainKind, dict[str, Size]] = {
    "flat": {},
    "stairs": {
        "steps": Size(default=14, low=1, high=100),
        "rise_m": Size(default=0.20, low=0.0, high=0.375, base=0.05, slope=0.25),
        "run_m": Size(default=0.25, low=0.1, high=2.0),
    },
    "stepping_stones": {
        "steps": Size(default=8, low=1, high=100),
        "stone_m": Size(default=0.5, low=0.1, high=2.0),
        "gap_m": Size(default=0.3, low=0.0, high=0.75, base=0.0, slope=0.6),
    },
    "step": {"height_m": Size(default=0.60, low=0.0, high=1.0, base=0.0, slope=0.8)},
    "gap": {"gap_m": Size(default=0.80, low=0.01, high=1.4, base=0.01, slope=1.1)},
}
GREATEST_GAP = Size(default=0.5, low=0.0, high=0.75)  # between stones; bounds of the gap itself


def make_terrain(config: TerrainConfig) -> Terrain:
    """Builds the terrain that `config` describes.

    Raises:
        ConfigError: there is no such terrain, a size or the difficulty is out of range, or a size is given that this
            terrain does not have.
    """
    if config.terrain.endswith(FILE_SUFFIX):
        return _from_file(config)
    if config.terrain not in get_args(TerrainKind):
        raise ConfigError(
            f"no terrain '{config.terrain}': {nearest_hint(config.terrain, get_args(TerrainKind))}; or give a TOML file"
        )
    kind = cast(TerrainKind, config.terrain)
    if config.layout_seed < 0:
        raise ConfigError(f"layout_seed = {config.layout_seed}: seeds are not negative")
    if config.difficulty is not None and not 0.0 <= config.difficulty <= 1.0:
        raise ConfigError(f"difficulty = {config.difficulty} is out of range: it must be from 0 to 1")
    table = TABLE[kind]
    given = {name: getattr(config, name) for name in SIZES}
    for name, value in given.items():
        if value is not None and name not in table:
            known = ", ".join(table) or "no sizes"
            raise ConfigError(f"{name} = {value} has no meaning for terrain '{config.terrain}', which has: {known}")
    sizes: dict[str, Any] = {name: size.resolve(name, given[name], config.difficulty) for name, size in table.items()}
    if "steps" in sizes:
        sizes["steps"] = int(sizes["steps"])
    if config.gap_max_m is not None:
        sizes |= _drawn_gaps(config, config.gap_max_m)
    return MAKERS[kind](**sizes)


def _from_file(config: TerrainConfig) -> Terrain:
    """The terrain of a file, whose sizes are in the file alone."""
    for name in (*SIZES, "gap_max_m", "difficulty"):
        if (value := getattr(config, name)) is not None:
            raise ConfigError(f"{name} = {value} has no meaning for {config.terrain}: its sizes are in the file")
    terrain = load(Terrain, Path(config.terrain))
    start_z = float(terrain.height_at(terrain.start_x, 0.0))
    if abs(start_z) > LEVEL_M:
        raise ConfigError(f"{config.terrain}: the ground at the start is {start_z:g} m high, it must be at 0")
    if terrain.finish_x <= terrain.start_x:
        raise ConfigError(
            f"{config.terrain}: finish_x = {terrain.finish_x:g} m, it must be beyond the start at {terrain.start_x:g} m"
        )
    return terrain


def _drawn_gaps(config: TerrainConfig, gap_max_m: float) -> dict[str, Any]:
    if config.terrain != "stepping_stones":
        raise ConfigError(f"gap_max_m = {gap_max_m} has no meaning for terrain '{config.terrain}': only for stones")
    greatest = GREATEST_GAP.resolve("gap_max_m", gap_max_m, None)
    return {"gap_max_m": greatest, "rng": np.random.default_rng(config.layout_seed)}


MAKERS: dict[TerrainKind, Callable[..., Terrain]] = {
    "flat": flat.make,
    "stairs": stairs.make,
    "stepping_stones": stepping_stones.make,
    "step": step.make,
    "gap": gap.make,
}
