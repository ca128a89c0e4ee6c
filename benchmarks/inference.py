"""Time of the heightmap service: features, image pooling and network, for one robot and for several at once.

    OMP_NUM_THREADS=1 saltus bench inference --json

Robots of a batch all ask at the same moment, which is the worst case; each has a new image at every second step, which
is cropped and pooled from the D435i's 80x240. Prints one JSON object on the last line; times in microseconds. The share
of a core is processor time, which other programs hardly change.
"""

import json
import os
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from saltus.depth import MILLIMETRE, MODEL_CAMERA, Intrinsics
from saltus.heightmap.service.fleet import Arrival, FleetService
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.replay import AssumeLevel
from saltus.heightmap.service.service import HeightmapService
from saltus.render.stereo.model_view import sampled_model_camera
from saltus.resources import resource
from saltus.wire.messages import DepthFrame, RobotState

TICKS = 4000
FLEET_TICKS = 2000
WARM_UP = 200
PERIOD_NS = 10_000_000
LATENCY_NS = 50_000_000
ROBOTS = (1, 2, 4, 8)
NATIVE_PIXELS = 5  # of the D435i in each direction for one pixel of the model
SCENES = 50  # different images, shown in turn


def frames(count: int, camera: Intrinsics, rng: np.random.Generator) -> list[DepthFrame]:
    """Images of the camera, one for each step; every second one is taken, and none of these is missing."""
    scenes = rng.integers(300, 2500, (SCENES, camera.height, camera.width)).astype(np.uint16)
    return [
        DepthFrame(
            time_ns=i * PERIOD_NS - LATENCY_NS,
            frame_id=i // 2,
            depth=scenes[i % SCENES],
            depth_unit_m=MILLIMETRE,
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx,
            cy=camera.cy,
        )
        for i in range(count)
    ]


class Stopwatch:
    """Times of many calls, on the wall and on the processor."""

    def __init__(self) -> None:
        self.wall_us: list[float] = []
        self.cpu_us: list[float] = []

    def time(self, call: Callable[[], object], count: bool) -> None:
        """Calls, and counts the time if it is to be counted."""
        wall, cpu = time.perf_counter_ns(), time.thread_time_ns()
        call()
        if count:
            self.cpu_us.append((time.thread_time_ns() - cpu) / 1e3)
            self.wall_us.append((time.perf_counter_ns() - wall) / 1e3)

    def row(self) -> dict[str, float]:
        """Percentiles, and how much of a core such calls at 100 Hz take."""
        p50, p99 = np.percentile(self.wall_us, [50, 99])
        share = float(np.mean(self.cpu_us)) / (1e-3 * PERIOD_NS)
        return {"p50_us": round(float(p50), 1), "p99_us": round(float(p99), 1), "core_share": round(share, 4)}


def one_robot(network: HeightmapNetwork, states: Sequence[RobotState], images: Sequence[DepthFrame]) -> Stopwatch:
    """Single steps with images of the model's own size."""
    service, watch = HeightmapService(network), Stopwatch()
    for state, frame in zip(states, images, strict=True):
        taken = frame if state.step % 2 == 0 else None
        watch.time(partial(service.step, state, taken, state.time_ns), state.step >= WARM_UP)
    return watch


def fleet(
    network: HeightmapNetwork, robots: int, states: Sequence[RobotState], images: Sequence[DepthFrame]
) -> Stopwatch:
    """Steps of so many robots together."""
    names = [f"robot/{i}" for i in range(robots)]
    service, watch = FleetService(network, names), Stopwatch()
    for state, frame in zip(states, images, strict=True):
        taken = frame if state.step % 2 == 0 else None
        boot = None if taken is None else b"camera"
        arrival = Arrival(state=state, robot_boot=b"robot", frame=taken, camera_boot=boot, now_ns=state.time_ns)
        watch.time(partial(service.step, dict.fromkeys(names, arrival)), state.step >= WARM_UP)
    return watch


def main() -> None:
    """Measures and prints."""
    rng, load = np.random.default_rng(0), os.getloadavg()[0]
    network = HeightmapNetwork(resource("models/heightmap.onnx"))
    small = frames(TICKS, MODEL_CAMERA, rng)
    large = frames(FLEET_TICKS, sampled_model_camera(NATIVE_PIXELS, NATIVE_PIXELS), rng)
    single = one_robot(network, AssumeLevel().states(small), small)
    states = AssumeLevel().states(large)
    rows = [{"n": count, **fleet(network, count, states, large).row()} for count in ROBOTS]
    last = rows[-1]
    fits = 1e3 * last["p99_us"] < PERIOD_NS and last["core_share"] < 1.0
    verdict = f"{last['n']} robots at 100 Hz: {100 * last['core_share']:.0f} % of a core"
    print(
        f"{verdict}, p99 {last['p99_us'] / 1e3:.2f} of 10 ms: they {'fit' if fits else 'do not fit'} (load {load:.1f})"
    )
    table = {
        **single.row(),
        "robots": rows,
        "eight_fit_one_core": bool(fits),
        "model_id": network.model_id,
        "load": round(load, 1),
    }
    print(json.dumps(table))


if __name__ == "__main__":
    main()
