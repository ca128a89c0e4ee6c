"""How fast the scan's network is trained.

saltus bench scan_training -- --batch 8 --updates 4
"""

import time
from dataclasses import dataclass, replace
from typing import Any

import torch

from benchmarks._command import Command
from saltus.heightmap.scan.training.settings import ScanTrainSettings
from saltus.heightmap.scan.training.train import ScanTrainer


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    """Images a second of the scan's training, flights included."""

    batch: int = 256
    """Robots at once; a processor takes 8."""
    updates: int = 96
    """In the round that is timed."""

    def measure(self) -> dict[str, Any]:
        """Speed of a training as it is, and on a GPU of one that is compiled."""
        on_gpu = torch.cuda.is_available()
        device = torch.device("cuda" if on_gpu else "cpu")
        settings = replace(ScanTrainSettings(), batch=self.batch, round=self.updates)
        figures: dict[str, Any] = {}
        for compiled in (False, True) if on_gpu else (False,):
            began = time.monotonic()
            trainer = ScanTrainer(settings, device, compiled=compiled)
            trainer.round(0.0, 0.01)
            warm = time.monotonic()
            trainer.round(0.01, 0.02)
            seconds = time.monotonic() - warm
            figures["compiled" if compiled else "as it is"] = {
                "first_round_s": round(warm - began, 1),
                "update_ms": round(1e3 * seconds / self.updates, 2),
                "images_per_s": round(self.updates * self.batch / seconds),
            }
        return figures
