"""Flags of the heights of any grid, any robot and any depth cameras."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from saltus.flags import flag_help

if TYPE_CHECKING:
    from saltus.heightmap.service.scan_fleet import ScanChoice

ROBOT = "robot"


@dataclass(frozen=True, kw_only=True)
class ScanOptions:
    """Points of the heights, form of the observation, cameras and body."""

    grid: Annotated[str | None, flag_help("STR", "that of the run: line, of the Go1's network")] = (
        None
    )
    """Points whose heights are told: scan, or a TOML file (`x` and `y`, lists of metres that
    ascend)."""
    dialect: Annotated[str | None, flag_help("STR", "none: heights alone")] = None
    """Beside the heights, the observation of a policy that was trained with isaaclab, legged_gym or
    mjlab."""
    cameras: Annotated[tuple[Path, ...], flag_help("PATH [PATH ...]", "the one of the run")] = ()
    """With a grid: TOML files that say where each camera sits. The first sends under camera/depth,
    others under camera/depth/NAME."""
    body: str = ROBOT
    """With a grid: what is taken out of the images. robot: legs and trunk of the run's robot; none;
    or a box of length, width and height around the base, as 0.6x0.4x0.5. With the last two states
    tell `standing_feet`, if any."""

    @property
    def scan_flags(self) -> list[str]:
        """Flags of the scan that were given, as arguments of the service's process."""
        given = {
            "--grid": self.grid,
            "--dialect": self.dialect,
            "--body": self.body if self.body != ROBOT else None,
        }
        flags = [
            part for flag, value in given.items() if value is not None for part in (flag, value)
        ]
        return [*flags, *(["--cameras", *map(str, self.cameras)] if self.cameras else [])]

    def scan_choice(self, model: Path | None) -> "ScanChoice | None":
        """The heights that are asked for; None for the line of one robot.

        Raises:
            ConfigError: no such grid, dialect or camera, or flags of a grid without one.
        """
        from saltus.heightmap.service.scan_fleet import ScanChoice

        return ScanChoice.of_flags(self.grid, self.dialect, self.cameras, self.body, model)
