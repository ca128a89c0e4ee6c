"""How long one image and one answer of the scan's predictor take on one core.

OMP_NUM_THREADS=1 saltus bench scan_step
"""

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks._command import Command
from saltus.grid import SCAN
from saltus.heightmap.scan.elevation import Measurement, Pose
from saltus.heightmap.scan.planes import MEASURED, MEMORY, NUMBERS, Inputs
from saltus.heightmap.scan.predictor import ScanNetwork, ScanPredictor
from saltus.heightmap.scan.training.draws import Draws
from saltus.heightmap.scan.training.export import export
from saltus.heightmap.scan.training.flights import draw_flight, shoot
from saltus.heightmap.scan.training.model import ScanModel
from saltus.heightmap.scan.training.settings import ScanTrainSettings


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    """Milliseconds of an image with map and network, of the network alone, and of 187 heights."""

    images: int = 40
    """Images of one flight, 48 at most."""

    def measure(self) -> dict[str, Any]:
        """Medians; weights are random, which costs the same."""
        torch.set_num_threads(1)
        settings = ScanTrainSettings()
        draws = Draws(0, torch.device("cpu"))
        flight = draw_flight(1, settings.flight, draws)
        shots = [shoot(flight, settings.flight, draws) for _ in range(min(self.images, settings.flight.images))]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "scan.onnx"
            export(ScanModel(settings.network, settings.map), settings, path)
            network = ScanNetwork(path)
        predictor = ScanPredictor(network)
        inputs = _inputs(settings.map.side)
        measured = [_alone(shot.measured) for shot in shots]
        image = [_ms(partial(predictor.see, m, float(s.now_s))) for m, s in zip(measured, shots, strict=True)]
        alone = [_ms(partial(network, inputs)) for _ in shots]
        answer = [_ms(partial(predictor.heights, m.now, 0.3, SCAN)) for m in measured]
        names = ("image_ms", "network_alone_ms", "heights_187_ms")
        return {
            name: round(float(np.median(times)), 3) for name, times in zip(names, (image, alone, answer), strict=True)
        }


def _ms(call: Callable[[], Any]) -> float:
    began = time.perf_counter()
    call()
    return 1e3 * (time.perf_counter() - began)


def _alone(measured: Measurement) -> Measurement:
    def plain(value: Any) -> Any:
        return Pose(*map(plain, value)) if isinstance(value, Pose) else value.numpy()

    return Measurement(*map(plain, measured))


def _inputs(side: int) -> Inputs:
    planes = [(side, side), (len(MEASURED), side, side), (len(MEMORY), side, side), (len(NUMBERS),)]
    return Inputs(*(np.zeros((1, *shape), np.float32) for shape in planes))
