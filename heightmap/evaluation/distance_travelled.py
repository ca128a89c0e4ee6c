"""Distance that robots travelled while a predictor was measured:
where they start, errors say little.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.terrain.terrain import FIRST_EDGE_X, Terrain

LEAST_SHARE = 0.5
"""Least share of the runs: of fewer the median robot has met nothing but the level ground at its
start."""


@dataclass(frozen=True, kw_only=True)
class DistanceTravelled:
    """How far one robot of an evaluation went, and how many edges it met."""

    distance_m: float
    """Distance of its trunk from its first place to the farthest [m]."""
    edges: int
    """Edges that it passed."""
    of_edges: int
    """Edges that its course has."""

    @classmethod
    def of(cls, terrain: Terrain, position: Floats) -> "DistanceTravelled":
        """The way of a trunk that was at these places of a terrain [m], shape (n, 3)."""
        away = np.linalg.norm(position[:, :2] - position[0, :2], axis=1)
        passed = (terrain.edges_x > position[0, 0]) & (terrain.edges_x <= position[:, 0].max())
        return cls(
            distance_m=float(away.max()), edges=int(passed.sum()), of_edges=len(terrain.edges_x)
        )

    @property
    def tells(self) -> bool:
        """True where it met an edge or, on flat ground,
        went as far as courses have their first one.
        """
        return self.edges > 0 if self.of_edges else self.distance_m >= FIRST_EDGE_X


def way_figures(ways: Sequence[DistanceTravelled]) -> dict[str, float]:
    """Median distance [m], edges that a robot met and could meet (means),
    share of ways that tell.
    """
    return {
        "distance_m": float(np.median([way.distance_m for way in ways])),
        "edges_met": float(np.mean([way.edges for way in ways])),
        "edges": float(np.mean([way.of_edges for way in ways])),
        "moved": float(np.mean([way.tells for way in ways])),
    }


def way_warning(figures: dict[str, float]) -> str:
    """Why errors of such runs are not to be taken for good.

    Empty where most of their robots moved.
    """
    if figures["moved"] >= LEAST_SHARE:
        return ""
    moved, least = 100.0 * figures["moved"], 100.0 * LEAST_SHARE
    return (
        f"these errors say little: {moved:.0f} % of the robots met an edge, or went "
        f"{FIRST_EDGE_X:g} m on flat ground, where {least:.0f} % are needed. The others fell or "
        "stood on level ground, which is easy to predict; compare saltus bench depth_to_heights "
        "score, whose robots go by true heights"
    )
