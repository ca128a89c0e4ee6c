"""Files in the folder of a training of the scan:
how it went, as CSV, and the checkpoint it continues from.
"""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from saltus.errors import ModelError

COLUMNS = (
    "update",
    "images",
    "seconds",
    "loss",
    "map_mm",
    "seen_mm",
    "unseen_mm",
    "inside_seen",
    "inside_all",
    "clipped",
    "rate",
)


@dataclass(frozen=True, kw_only=True)
class ScanTrainingProgress:
    """How far a training of the scan's network is; figures are means over the last round."""

    update: int
    images: int
    seconds: float
    loss: float
    map_mm: float
    """Mean absolute error of the map, without the network, within 3 cm of what was measured [mm].

    Where points lie dense no network betters it; what the network adds is beside them."""
    seen_mm: float
    """Mean absolute error with the network, within 3 cm of what was measured [mm]."""
    unseen_mm: float
    inside_seen: float
    """Share within the half-width."""
    inside_all: float
    clipped: float
    """Share of the weights' gradients that were more than twice their usual size."""
    rate: float
    """Learning rate."""


def read_scan_checkpoint(path: Path) -> dict[str, Any]:
    """The table that `Trainer.save` wrote, or `ModelError`."""
    try:
        table = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # what a file that is something else makes of its unpickling
        raise ModelError(
            f"{path} is no checkpoint of a scan's network: torch cannot read it"
        ) from error
    if (
        not isinstance(table, dict)
        or not {"settings", "rounds", "model", "average"} <= table.keys()
    ):
        raise ModelError(f"{path} is no checkpoint of a scan's network")
    return table


def trained_images(folder: Path) -> int:
    """How many images the training in a folder has seen, by its CSV; 0 where there is none."""
    path = folder / "scan.csv"
    if not path.exists():
        return 0
    with path.open(newline="", encoding="utf-8") as file:
        return max((int(float(row["images"])) for row in csv.DictReader(file)), default=0)


def write_row(path: Path, found: ScanTrainingProgress) -> None:
    """Adds where the training is to its CSV."""
    is_new = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if is_new:
            writer.writerow(COLUMNS)
        writer.writerow([f"{getattr(found, name):.6g}" for name in COLUMNS])
