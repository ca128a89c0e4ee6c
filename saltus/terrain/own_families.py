"""Families of terrain of one's own: functions that installed packages name
in the entry-point group `saltus.terrains`.

    [project.entry-points."saltus.terrains"]
    ledges = "my_package.ledges:make"

The function takes the difficulty, from 0 to 1, and a generator from which it draws all that is
random, and returns a `Terrain`. Then `ledges` is a terrain like any other: to look at, to run, to
evaluate and to train on.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, entry_points

import numpy as np

from saltus.errors import ConfigError
from saltus.terrain.terrain import Terrain, check_terrain

GROUP = "saltus.terrains"
MEDIUM = 0.5
"""The difficulty where none is given."""


@dataclass(frozen=True)
class OwnFamily:
    """A family of terrains of another package, which is loaded when its first terrain is made."""

    entry: EntryPoint

    def __call__(self, difficulty: float | None, rng: np.random.Generator) -> Terrain:
        """A terrain of the family.

        Raises:
            ConfigError: the function cannot be found, fails, or returns no terrain that a robot can
                start on.
        """
        difficulty = MEDIUM if difficulty is None else difficulty
        where = f"terrain '{self.entry.name}' ({self.entry.value})"
        try:
            function: Callable[..., Terrain] = self.entry.load()
            terrain = function(difficulty, rng)
        except Exception as error:  # whatever goes wrong in another's code
            raise ConfigError(f"{where} failed: {type(error).__name__}: {error}") from error
        if not isinstance(terrain, Terrain):
            raise ConfigError(
                f"{where} returned {type(terrain).__name__}: its function must return a Terrain"
            )
        return check_terrain(
            replace(terrain, params={"difficulty": difficulty} | terrain.params), where
        )


def own_families() -> dict[str, OwnFamily]:
    """Families of terrains of all packages that are installed here, by name."""
    return {entry.name: OwnFamily(entry) for entry in entry_points(group=GROUP)}
