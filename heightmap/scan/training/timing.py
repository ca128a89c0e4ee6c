"""`python -m saltus.heightmap.scan.training.timing`: how long each piece of an update takes."""

import sys
import time
from collections.abc import Callable
from typing import Any

import torch

from saltus.heightmap.scan.elevation import advanced, new_map
from saltus.heightmap.scan.planes import inputs_of
from saltus.heightmap.scan.training.draws import Draws
from saltus.heightmap.scan.training.flights import draw_flight, shoot, true_heights
from saltus.heightmap.scan.training.model import ScanModel, loss, told
from saltus.heightmap.scan.training.rays import first_hits
from saltus.heightmap.scan.training.settings import ScanTrainSettings


def main() -> int:
    """Prints milliseconds of each piece, for the batch of `ScanTrainSettings`."""
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    settings = ScanTrainSettings()
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = True
    draws = Draws(0, device)
    model = ScanModel(settings.network, settings.map).to(device, memory_format=torch.channels_last)
    runs: list[tuple[str, Callable[..., Any], Any]] = [("eager", first_hits, model)]
    if device.type == "cuda":
        runs.append(("compiled", torch.compile(first_hits), torch.compile(model)))
    flight = _timed("flights", lambda: draw_flight(settings.batch, settings.flight, draws), device)
    for name, march, run in runs:
        shot = _timed(f"image, {name}", lambda march=march: shoot(flight, settings.flight, draws, march), device)
        state = new_map(settings.batch, settings.map, flight.ground.height)
        state, around = _timed("map", lambda: advanced(state, shot.measured, settings.map), device)  # noqa: B023
        inputs = _timed("planes", lambda: inputs_of(state, around, shot.now_s, shot.measured.body_height), device)  # noqa: B023
        truth = _timed(
            "truth",
            lambda: true_heights(flight, shot, state, around, settings.map, settings.flight),  # noqa: B023
            device,
        )

        def learn(run: Any = run, inputs: Any = inputs, around: Any = around, truth: Any = truth) -> None:
            with torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda"):
                estimate = told(run, inputs, around.filled)
            loss(estimate, truth, torch.ones_like(truth)).backward()

        _timed(f"network and gradient, {name}", learn, device)
    if device.type == "cuda":
        print(f"memory {torch.cuda.max_memory_allocated() / 2**30:.1f} GiB")
    return 0


def _timed(name: str, call: Callable[[], Any], device: torch.device, repeats: int = 5) -> Any:
    found = None
    for _ in range(3 if device.type == "cuda" else 0):  # compiles, and takes memory
        found = call()
    if device.type == "cuda":
        torch.cuda.synchronize()
    began = time.perf_counter()
    for _ in range(repeats):
        found = call()
    if device.type == "cuda":
        torch.cuda.synchronize()
    print(f"{name:32} {1e3 * (time.perf_counter() - began) / repeats:8.2f} ms", flush=True)
    return found


if __name__ == "__main__":
    sys.exit(main())
