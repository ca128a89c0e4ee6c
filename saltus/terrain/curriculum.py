"""From a configuration to a terrain: a family makes it, by explicit sizes or by the difficulty.

Or a file holds it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from saltus.config import TerrainConfig, load_config
from saltus.errors import ConfigError, nearest_hint
from saltus.terrain import clutter, flat, level, ramp
from saltus.terrain.course import CourseFamily, course_family, shipped_courses
from saltus.terrain.own_families import OwnFamily, own_families
from saltus.terrain.terrain import TRENCH_DEPTH, Terrain, check_terrain

FILE_SUFFIX = ".toml"
SIZES = (
    "steps",
    "rise_m",
    "run_m",
    "stone_m",
    "gap_m",
    "height_m",
    "gap_max_m",
    "depth_m",
    "depth_max_m",
    "slope_deg",
)


@dataclass(frozen=True, kw_only=True)
class FamilySize:
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
            raise ConfigError(
                f"{name} = {value} is out of range: it must be from {self.low:g} to {self.high:g}"
            )
        return value


@dataclass(frozen=True, kw_only=True)
class SizedFamily:
    """A family whose sizes can be given one by one,
    each in place of what the difficulty or a default would make it.
    """

    make: Callable[..., Terrain]
    """Takes the sizes by their names, and `rng` where something is drawn."""
    sizes: dict[str, FamilySize] = field(default_factory=dict)
    greatest: dict[str, FamilySize] = field(default_factory=dict)
    """Sizes that can be given besides, with which others are drawn."""
    is_drawn: bool = False
    """True where courses of other random numbers differ whatever the sizes are."""

    def __call__(
        self, difficulty: float | None, rng: np.random.Generator, **given: float
    ) -> Terrain:
        """A terrain of the family, see `make_terrain`."""
        sizes: dict[str, Any] = {
            n: size.resolve(n, given.get(n), difficulty) for n, size in self.sizes.items()
        }
        if "steps" in sizes:
            sizes["steps"] = int(sizes["steps"])
        drawn = {
            n: size.resolve(n, given[n], None) for n, size in self.greatest.items() if n in given
        }
        return self.make(**sizes, **drawn, **({"rng": rng} if drawn or self.is_drawn else {}))


# The laws of difficulty are the project's definition (the original's, with gap and step widened so
# that difficulty 1 is beyond the paper's best jumps of 0.8 m and 0.6 m; of the kinds that the paper
# does not have, a third or more beyond what a robot should take, which is the default). Defaults:
# the courses of the paper's robot, with the mean of its gaps between stones. Bounds: the least that
# a foot of 4 cm can tell from flat ground or stand on, up to a quarter more than difficulty 1 asks
# for.
_RISE = FamilySize(default=0.15, low=0.0, high=0.3125, base=0.05, slope=0.20)
_RUN = FamilySize(default=0.25, low=0.1, high=2.0)
_GAP = FamilySize(default=0.80, low=0.01, high=1.4, base=0.01, slope=1.1)
_DEPTH = FamilySize(default=TRENCH_DEPTH, low=0.01, high=1.25)
_RAMP = {
    "slope_deg": FamilySize(default=20.0, low=0.0, high=37.5, base=0.0, slope=30.0),
    "run_m": FamilySize(default=3.0, low=0.1, high=20.0),
}


def _count(default: int) -> FamilySize:
    return FamilySize(default=default, low=1, high=100)


def _level(kind: str, **sizes: FamilySize) -> SizedFamily:
    """A family of `saltus.terrain.course_law`."""
    return SizedFamily(make=partial(level.make, kind), sizes=sizes, is_drawn=kind == "irregular")


FAMILIES: dict[str, SizedFamily] = {
    "flat": SizedFamily(make=flat.make),
    "stairs": _level(
        "stairs",
        steps=_count(14),
        rise_m=FamilySize(default=0.20, low=0.0, high=0.375, base=0.05, slope=0.25),
        run_m=_RUN,
    ),
    "stepping_stones": replace(
        _level(
            "stepping_stones",
            steps=_count(8),
            stone_m=FamilySize(default=0.5, low=0.1, high=2.0),
            gap_m=FamilySize(default=0.3, low=0.0, high=0.75, base=0.0, slope=0.6),
        ),
        greatest={"gap_max_m": FamilySize(default=0.5, low=0.0, high=0.75)},
    ),
    "step": _level(
        "step", height_m=FamilySize(default=0.60, low=0.0, high=1.0, base=0.0, slope=0.8)
    ),
    "gap": _level("gap", gap_m=_GAP),
    "stairs_down": _level("stairs_down", steps=_count(14), rise_m=_RISE, run_m=_RUN),
    "step_down": _level(
        "step_down", height_m=FamilySize(default=0.60, low=0.0, high=1.0, base=0.0, slope=0.8)
    ),
    "pyramid": _level("pyramid", steps=_count(5), rise_m=_RISE, run_m=replace(_RUN, default=0.3)),
    "irregular": _level(
        "irregular", steps=_count(14), rise_m=replace(_RISE, default=0.22, low=-_RISE.high)
    ),
    "hurdles": _level(
        "hurdles",
        steps=_count(3),
        height_m=FamilySize(default=0.20, low=0.0, high=0.375, base=0.0, slope=0.30),
        run_m=FamilySize(default=1.5, low=0.1, high=5.0),
    ),
    "ditch": replace(
        _level("ditch", gap_m=replace(_GAP, default=0.5), depth_m=_DEPTH),
        greatest={"depth_max_m": _DEPTH},
    ),
    "ramp_up": SizedFamily(make=partial(ramp.make, "ramp_up"), sizes=_RAMP),
    "ramp_down": SizedFamily(make=partial(ramp.make, "ramp_down"), sizes=_RAMP),
}
"""Those that Saltus brings; installed packages add theirs (`saltus.terrain.own_families`)."""
SCENERY: dict[str, SizedFamily] = {
    "clutter": SizedFamily(
        make=clutter.make,
        sizes={"height_m": FamilySize(default=0.5, low=0.06, high=1.5, base=0.1, slope=1.1)},
        is_drawn=True,
    )
}
"""Terrains that predictors are shown beside courses; no robot has to cross them."""
_BROUGHT = FAMILIES | SCENERY


def make_terrain(config: TerrainConfig) -> Terrain:
    """Builds the terrain that `config` describes;
    its family may be a course's TOML file or installed.

    Raises:
        ConfigError: there is no such terrain, a size or the difficulty is out of range, or a size
            is given that this terrain does not have.
    """
    given = {name: value for name in SIZES if (value := getattr(config, name)) is not None}
    if config.terrain.endswith(FILE_SUFFIX) and course_family(config.terrain) is None:
        return _from_file(config, given)
    family = find_family(config.terrain)
    if config.layout_seed < 0:
        raise ConfigError(f"layout_seed = {config.layout_seed}: seeds are not negative")
    if config.difficulty is not None and not 0.0 <= config.difficulty <= 1.0:
        raise ConfigError(
            f"difficulty = {config.difficulty} is out of range: it must be from 0 to 1"
        )
    rng = np.random.default_rng(config.layout_seed)
    if isinstance(family, SizedFamily):
        _refuse(config, given, [*family.sizes, *family.greatest])
        return family(config.difficulty, rng, **given)
    _refuse(config, given, [])
    return family(config.difficulty, rng)


def find_family(name: str) -> SizedFamily | CourseFamily | OwnFamily:
    """The family of that name.

    Raises:
        ConfigError: there is none.
    """
    if (course := course_family(name)) is not None:
        return course
    families: dict[str, SizedFamily] | dict[str, OwnFamily] = (
        _BROUGHT if name in _BROUGHT else own_families()
    )
    if name not in families:
        if name.endswith(FILE_SUFFIX):
            raise ConfigError(
                f"{name} is one course, without difficulties: let a family of yours return it"
            )
        known = [*_BROUGHT, *shipped_courses(), *families]
        raise ConfigError(f"no terrain '{name}': {nearest_hint(name, known)}; or give a TOML file")
    return families[name]


def is_drawn(config: TerrainConfig) -> bool:
    """True where terrains of another layout seed differ."""
    if course_family(config.terrain) is not None:
        return True
    if config.terrain.endswith(FILE_SUFFIX):
        return False
    family = _BROUGHT.get(config.terrain)
    return (
        family is None
        or family.is_drawn
        or any(getattr(config, n) is not None for n in family.greatest)
    )


def _refuse(config: TerrainConfig, given: dict[str, float], known: list[str]) -> None:
    for name, value in given.items():
        if name not in known:
            has = ", ".join(known) or "no sizes"
            raise ConfigError(
                f"{name} = {value} has no meaning for terrain '{config.terrain}', which has: {has}"
            )


def _from_file(config: TerrainConfig, given: dict[str, float]) -> Terrain:
    """The terrain of a file, whose sizes are in the file alone."""
    if config.difficulty is not None:
        given = {**given, "difficulty": config.difficulty}
    for name, value in given.items():
        raise ConfigError(
            f"{name} = {value} has no meaning for {config.terrain}: its sizes are in the file"
        )
    return check_terrain(load_config(Terrain, Path(config.terrain)), config.terrain)
