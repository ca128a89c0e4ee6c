"""The points at which heights are asked, sent and predicted."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Constant, Places, Points, Scalars, namespace
from saltus.config import TomlValue, load_config
from saltus.errors import ConfigError, nearest_hint

_ROUNDING_M = 1e-6


@dataclass(frozen=True, kw_only=True)
class HeightGrid(TomlValue):
    """Points in the yaw-aligned frame of the base: x ahead, y to the left.

    Row after row, each from its first y on.

    Raises:
        ConfigError: a coordinate is not finite, or coordinates are not ascending.
    """

    x: tuple[float, ...]
    """X of the rows, ascending [m]."""
    y: tuple[float, ...] = (0.0,)
    """Y of the columns, ascending [m]."""

    def __post_init__(self) -> None:
        for name in ("x", "y"):
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if not value.size or not np.isfinite(value).all() or not (np.diff(value) > 0.0).all():
                raise ConfigError(
                    f"{name} of a height grid is {value.tolist()}: it must be finite numbers that "
                    "ascend"
                )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return len(self.x), len(self.y)

    @property
    def size(self) -> int:
        """Number of points."""
        return len(self.x) * len(self.y)

    def equals(self, other: "HeightGrid") -> bool:
        """True where the points are the same,
        but for rounding of numbers that went through text.
        """
        sides = ((self.x, other.x), (self.y, other.y))
        return all(
            len(a) == len(b) and np.allclose(a, b, rtol=0.0, atol=_ROUNDING_M) for a, b in sides
        )

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """Place of each point, x and y [m], shape (size, 2)."""
        return np.stack(np.meshgrid(self.x, self.y, indexing="ij"), axis=-1).reshape(-1, 2)

    def places_of(self, other: "HeightGrid") -> NDArray[np.intp]:
        """Place of each point of another grid among the points of this one, shape (other.size,).

        Raises:
            ConfigError: a point is not among them.
        """
        found = []
        for name in ("x", "y"):
            own, asked = np.array(getattr(self, name)), np.array(getattr(other, name))
            nearest = np.abs(asked[:, None] - own).argmin(axis=1)
            if np.abs(own[nearest] - asked).max() > _ROUNDING_M:
                raise ConfigError(
                    f"{name} of a height grid is {asked.tolist()}: it must be among {own.tolist()}"
                )
            found.append(nearest)
        rows, columns = found
        return (rows[:, None] * len(self.y) + columns).reshape(-1)

    def with_points_of(self, other: "HeightGrid") -> "HeightGrid":
        """The smallest grid with the points of both."""
        sides = ((self.x, other.x), (self.y, other.y))
        x, y = (tuple(_distinct(np.sort(np.array(a + b))).tolist()) for a, b in sides)
        return HeightGrid(x=x, y=y)

    def points_in_world(
        self, position: Places, yaw: Scalars, ahead: Scalars = 0.0
    ) -> tuple[Points, Points]:
        """World x and y of each point [m], each of shape (..., size).

        Args:
            position: Of the base [m], numpy or torch, shape (..., 2) or (..., 3).
            yaw: Of the base [rad], shape (...).
            ahead: Every point is taken to be this much further ahead [m], shape (...) or one
                number.
        """
        xp = namespace(position)
        cosine, sine = xp.cos(yaw)[..., None], xp.sin(yaw)[..., None]
        x, y = (constant.like(position) for constant in self._constants)
        if not isinstance(ahead, float):
            ahead = ahead[..., None]
        x = x + ahead
        return position[..., :1] + (cosine * x - sine * y), position[..., 1:2] + (
            sine * x + cosine * y
        )

    @cached_property
    def _constants(self) -> tuple[Constant, Constant]:
        return Constant(self.points[:, 0]), Constant(self.points[:, 1])


SCAN = HeightGrid(
    x=tuple(np.linspace(-0.8, 0.8, 17).tolist()), y=tuple(np.linspace(-0.5, 0.5, 11).tolist())
)
"""The 187 points that policies of IsaacLab, legged_gym and mjlab are trained on: 1.6 x 1.0 m at 0.1
m."""

LINE = HeightGrid(x=tuple(np.linspace(-0.4, 0.8, 30).tolist()))
"""The original's: 30 points on one line along the yaw."""


def _distinct(ascending: NDArray[np.float64]) -> NDArray[np.float64]:
    """Numbers without those that differ from the one before by rounding alone."""
    return ascending[np.append(True, np.diff(ascending) > _ROUNDING_M)]


SCAN_AND_LINE = SCAN.with_points_of(LINE)
"""The 495 points of a planner that walks by the scan and jumps by the line."""

GRIDS = {"line": LINE, "scan": SCAN, "scan_and_line": SCAN_AND_LINE}
"""Grids by name."""
WALKING_GRID = "scan_and_line"
"""The grid of a run whose robot walks by the scan and jumps by the line."""
DEFAULT_GRID = "line"
"""The grid that a command takes where none is named, of the network of one robot; nothing below
entry points reads it."""

HEIGHTMAP_X = np.array(LINE.x)
"""Distance of each height of `LINE` ahead of the base [m]."""


def grid_metadata(grid: HeightGrid) -> dict[str, list[float]]:
    """The form in which a file states its grid [m]; `stated_grid` reads it."""
    aside = {} if grid.y == (0.0,) else {"grid_y_m": list(grid.y)}
    return {"grid_m": list(grid.x), **aside}


def stated_grid(metadata: Mapping[str, Any]) -> HeightGrid:
    """The grid that a file states with `grid_metadata`.

    Raises:
        ConfigError: what it states is no grid.
    """
    try:
        x, y = (
            tuple(map(float, numbers))
            for numbers in (metadata["grid_m"], metadata.get("grid_y_m", [0.0]))
        )
    except (TypeError, ValueError):
        raise ConfigError(f"'grid_m' is {metadata['grid_m']!r}: it must be numbers") from None
    return HeightGrid(x=x, y=y)


def load_grid(name_or_path: str) -> HeightGrid:
    """A grid by name, or from a TOML file.

    Raises:
        ConfigError: neither a name nor a file, or no grid.
    """
    if name_or_path in GRIDS:
        return GRIDS[name_or_path]
    path = Path(name_or_path)
    if path.suffix != ".toml":
        raise ConfigError(
            f"no grid '{name_or_path}': {nearest_hint(name_or_path, GRIDS)}; or give a TOML file"
        )
    return load_config(HeightGrid, path)
