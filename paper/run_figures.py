"""Summaries and drawings of runs that several rows share."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from paper.drawing import FRONT, REAR, draw_ground, legend
from paper.runs import Ran
from saltus.arrays import Floats
from saltus.config import TerrainConfig
from saltus.terrain.curriculum import make_terrain

STAIRS = TerrainConfig(terrain="stairs", steps=14, rise_m=0.20, run_m=0.25)
"""The paper's staircase: 14 steps, 3.5 m long and 2.8 m high."""
STONES = TerrainConfig(
    terrain="stepping_stones", stone_m=0.5, gap_m=0.1, gap_max_m=0.5, layout_seed=1
)
"""The paper does not say how wide its stones and gaps are."""
COURSES = {
    "stairs": STAIRS,
    "stepping stones": STONES,
    "step": TerrainConfig(terrain="step", height_m=0.60),
    "gap": TerrainConfig(terrain="gap", gap_m=0.80),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Made:
    """Result of a row."""

    numbers: dict[str, Any]
    figure: Any
    """Figure of matplotlib."""
    configuration: dict[str, Any]
    """Sizes and kinds of what was run."""
    most_seeds: int | None = None
    """Most seeds of those that were asked for, where not all are run."""


def summary(runs: Sequence[Ran]) -> dict[str, Any]:
    """Summary of one course."""
    return {
        **success(runs),
        "speed_mps": spread(values_of(runs, "speed_mps")),
        "time_s": spread([run.outcome.time_s for run in runs if run.outcome.success]),
        "jumps": spread(values_of(runs, "jumps")),
    }


def success(runs: Sequence[Ran]) -> dict[str, int]:
    """Successes of how many trials."""
    return {"success": sum(run.outcome.success for run in runs), "trials": len(runs)}


def values_of(runs: Sequence[Ran], key: str) -> list[float]:
    """Values of successes."""
    good = [run for run in runs if run.outcome.success]
    return [float(run.jumps) if key == "jumps" else run.outcome.mean_speed_mps for run in good]


def spread(values: Sequence[float]) -> dict[str, float] | None:
    """Least, median and greatest; nothing where there are no values."""
    if not values:
        return None
    low, median, high = np.quantile(np.asarray(values, np.float64), (0.0, 0.5, 1.0)).tolist()
    return {"least": round(low, 3), "median": round(median, 3), "most": round(high, 3)}


def on_ground(run: Ran) -> Any:
    """A leg that is to stand bears, once the robot bounds."""
    return run.going & (run.trace.stance & run.trace.loaded).any(axis=-1)


def first_success(runs: Sequence[Ran]) -> Ran:
    """The first that succeeded; the first of all where none did."""
    return next((run for run in runs if run.outcome.success), runs[0])


def draw_side(axis: Any, run: Ran, low: float, high: float) -> None:
    """The course and the base from the side, with the places where feet landed."""
    draw_ground(axis, run.terrain, low, high)
    axis.plot(*run.trace.base.T, color="0.3", linewidth=1)
    for pair, colour in (("front", FRONT), ("rear", REAR)):
        places: Floats = np.array(
            [(landing.x, landing.z) for landing in run.landings(pair)]
        ).reshape(-1, 2)
        axis.plot(*places.T, "o", color=colour, markersize=5, label=f"{pair} feet")
    axis.set_xlabel("x [m]")
    axis.set_ylabel("z [m]")
    legend(axis, fontsize=8, loc="lower right")  # on the ground


def sizes_of_courses(courses: dict[str, TerrainConfig]) -> dict[str, Any]:
    """The sizes of courses, for a configuration."""
    return {
        "courses": {name: dict(make_terrain(course).params) for name, course in courses.items()}
    }
