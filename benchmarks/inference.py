"""Time of one tick of the heightmap service at batch 1: features, image pooling and network.

    OMP_NUM_THREADS=1 python benchmarks/inference.py

Prints one JSON line; times in microseconds. A tick with a new image also crops and pools it.
"""

import json
import time
from collections.abc import Sequence

import numpy as np

from heightmap.replay import AssumeLevel
from heightmap.service import HeightmapService
from saltus.depth import MILLIMETRE, MODEL_CAMERA
from saltus.messages import DepthFrame
from saltus.resources import resource

TICKS = 4000
WARM_UP = 200
PERIOD_NS = 10_000_000
LATENCY_NS = 50_000_000


def _frame(index: int, time_ns: int, rng: np.random.Generator) -> DepthFrame:
    camera = MODEL_CAMERA
    return DepthFrame(
        time_ns=time_ns,
        frame_id=index,
        depth=rng.integers(300, 2500, (camera.height, camera.width)).astype(np.uint16),
        depth_unit_m=MILLIMETRE,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
    )


def _row(times_us: Sequence[float]) -> dict[str, float]:
    p50, p99 = np.percentile(times_us, [50, 99])
    return {"p50": round(float(p50), 1), "p99": round(float(p99), 1), "max": round(float(np.max(times_us)), 1)}


def main() -> None:
    """Measures and prints."""
    rng = np.random.default_rng(0)
    service = HeightmapService(resource("models/heightmap.onnx"))
    frames = [_frame(i, i * PERIOD_NS - LATENCY_NS, rng) for i in range(TICKS)]
    times: dict[bool, list[float]] = {True: [], False: []}
    for state, frame in zip(AssumeLevel().states(frames), frames, strict=True):
        new = state.step % 2 == 0
        start = time.perf_counter_ns()
        service.step(state, frame if new else None, state.time_ns)
        if state.step >= WARM_UP:
            times[new].append((time.perf_counter_ns() - start) / 1e3)
    every = times[True] + times[False]
    result = {"step_us": _row(every), "with_new_image_us": _row(times[True]), "without_us": _row(times[False])}
    print(json.dumps({"benchmark": "inference", "model_id": service.model_id, "ticks": len(every), **result}))


if __name__ == "__main__":
    main()
