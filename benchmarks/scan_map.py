"""Other numbers of the scan's classical map, one at a time, without a network.

The rival that a network has to beat deserves the best numbers, and the network starts from the same
map.

    saltus bench scan_map -- --robots 16
"""

from dataclasses import dataclass, replace
from typing import Any

import torch

from benchmarks._command import Command, tell
from saltus.heightmap.scan.settings import MapSettings
from saltus.heightmap.scan.training.evaluation import (
    ScanScore,
    evaluate_scan,
    evaluation_rows,
    rivals_of,
)
from saltus.heightmap.scan.training.settings import ScanTrainSettings

TRIED: dict[str, tuple[float, ...]] = {
    "depth_noise": (0.002, 0.008),
    "point_noise_m": (0.002, 0.005),
    "shared_noise": (0.1, 0.6),
    "drift": (0.01, 0.03),
    "least_m": (0.002, 0.008),
    "step_m": (0.002, 0.008),
    "tilt_rad": (1e-5, 0.002, 0.008),
    "independent": (0.01, 0.1),
    "gate_m": (0.03, 0.1),
    "foot_gain": (0.1, 0.2, 0.6),
    "foot_noise_m": (0.003, 0.01),
    "surprise": (0.0, 0.03, 0.3),
}
"""Values beside the usual one, one number at a time."""
GROUPS = ("seen", "visible", "remembered", "never")


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    """Errors [mm] of the scan's points for other numbers of the classical map, one at a time."""

    robots: int = 64
    """In each row; on a GPU 256 take as long."""
    rows: tuple[str, ...] = ("usual", "bad odometry", "good odometry")
    """Rows of the evaluation."""

    def measure(self) -> dict[str, Any]:
        """Errors by row, variant and group."""
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        settings = ScanTrainSettings()
        known, variants = evaluation_rows(settings.flight), variants_of(settings.map)
        figures: dict[str, Any] = {}
        for row in self.rows:
            flights = {row: known[row]}
            scores = evaluate_scan(
                None, settings, robots=self.robots, device=device, rows=flights, rivals=variants
            )
            figures[row] = by_method(scores)
            for method, errors in figures[row].items():
                tell(
                    f"{row:14} {method:24} "
                    + "  ".join(f"{errors[group]:7.2f}" for group in GROUPS)
                )
        return figures


def variants_of(settings: MapSettings) -> dict[str, MapSettings]:
    """The usual maps, and those with one other number."""
    variants = dict(rivals_of(settings))
    for name, values in TRIED.items():
        for value in values:
            variants[f"{name} {value:g}"] = replace(settings, **{name: value})  # type: ignore[arg-type]
    return variants


def by_method(scores: list[ScanScore]) -> dict[str, dict[str, float]]:
    """Errors of the scan's points [mm] by method and group."""
    found: dict[str, dict[str, float]] = {}
    for score in scores:
        if score.family == "every" and score.grid == "scan":
            found.setdefault(score.method, {})[score.group] = round(score.error_mm, 2)
    return found
