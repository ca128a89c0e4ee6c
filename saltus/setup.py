"""Everything that a run is of, as one value:
the command line names it, and everybody below is handed it.
"""

from dataclasses import dataclass, fields
from typing import Any, Self, cast

import tomli_w

from saltus.config import TomlValue, read_toml
from saltus.depth_camera import DepthCamera
from saltus.effects.profile import Profile
from saltus.errors import ConfigError
from saltus.grid import HeightGrid
from saltus.robots.robot import Robot
from saltus.terrain.terrain import Terrain
from saltus.trial import Trial


@dataclass(frozen=True, kw_only=True)
class Setup(TomlValue):
    """Everything about one robot on its course: robot, grid, terrain, profile, camera, trial."""

    robot: Robot
    """With its camera where `camera` sits."""
    grid: HeightGrid
    """Points at which heights are asked, predicted and sent."""
    terrain: Terrain
    profile: Profile
    """Hardware as its camera delivers, without what the trial draws."""
    camera: DepthCamera
    trial: Trial

    @property
    def hardware(self) -> Profile:
        """The effects of this robot in its trial; the errors of `Trial.applied_to`."""
        return self.trial.applied_to(self.profile)

    def to_toml(self) -> str:
        """A table for each value, in the form of its own."""
        return tomli_w.dumps(
            {f.name: read_toml(getattr(self, f.name).to_toml()) for f in fields(self)},
            multiline_strings=True,
        )

    @classmethod
    def from_toml(cls, text: str) -> Self:
        """Reads what `to_toml` writes.

        Raises:
            ConfigError: not TOML, or a table that is missing, unknown or none of its value; the
                message names it.
        """
        tables, kinds = (
            read_toml(text),
            {f.name: cast(type[TomlValue], f.type) for f in fields(cls)},
        )
        if tables.keys() != kinds.keys():
            raise ConfigError(
                f"it has the tables {', '.join(tables)}: it must have {', '.join(kinds)}"
            )
        values: dict[str, Any] = {}
        for name, kind in kinds.items():
            try:
                values[name] = kind.from_toml(tomli_w.dumps(tables[name], multiline_strings=True))
            except ConfigError as error:
                raise ConfigError(f"[{name}] {error}") from error
        return cls(**values)
