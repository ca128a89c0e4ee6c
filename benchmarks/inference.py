"""Time of the heightmap service: features, image pooling and network,
for one robot and for several at once.

Robots of a batch all ask at the same moment, which is the worst case; each has a new image at every
second step, which is cropped and pooled from the D435i's 80x240. Times are in microseconds. The
share of a core is processor time, which other programs hardly change.

Between steps of the one robot ONNX Runtime runs the network alone, on zeros: `over_network` is how
much more a step costs, median of the processor time. `copies_over_network` is the same of the
network with nothing but its inputs copied in and its outputs copied out: the least of a service in
Python.

    OMP_NUM_THREADS=1 saltus bench inference
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._command import Command
from benchmarks._measuring import Stopwatch, random_frames
from saltus.depth import MODEL_CAMERA, Intrinsics, model_image, supersampled_model_camera
from saltus.heightmap.level_robot import LevelRobot
from saltus.heightmap.service.fleet import FleetService, RobotRequest
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION
from saltus.heightmap.service.service import HeightmapService
from saltus.model_file import ModelFile
from saltus.resources import shipped_file
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.wire.messages import DepthFrame, RobotState

WARM_UP = 200
PERIOD_NS = 10_000_000
LATENCY_NS = 50_000_000
ROBOTS = (1, 2, 4, 8)
NATIVE_PIXELS = 5  # of the D435i in each direction for one pixel of the model
SCENES = 50  # different images, shown in turn


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    ticks: int = 4000
    """Steps of one robot, the first 200 of them to warm up; several robots make half as many."""

    def measure(self) -> dict[str, Any]:
        rng, load = np.random.default_rng(0), os.getloadavg()[0]
        path = shipped_file("models/heightmap.onnx")
        network = HeightmapNetwork(load_robot(DEFAULT_ROBOT), path)
        small = frames(self.ticks, MODEL_CAMERA, rng)
        large = frames(
            self.ticks // 2, supersampled_model_camera(NATIVE_PIXELS, NATIVE_PIXELS), rng
        )
        states = LevelRobot().states(network.robot, small)
        single, alone, copied = one_robot(network, states, small, network_alone(path))
        states = LevelRobot().states(network.robot, large)
        rows = [{"n": count, **row(fleet(network, count, states, large))} for count in ROBOTS]
        last = rows[-1]
        return {
            **row(single),
            "network_alone": row(alone),
            "over_network": over(single, alone),
            "copies_over_network": over(copied, alone),
            "robots": rows,
            "eight_fit_one_core": bool(
                1e3 * last["p99_us"] < PERIOD_NS and last["core_share"] < 1.0
            ),
            "model_id": network.model_id,
            "load": round(load, 1),
        }


def frames(count: int, camera: Intrinsics, rng: np.random.Generator) -> list[DepthFrame]:
    """Images of the camera, one for each step.

    Every second one is taken, and none of these is missing.
    """
    scenes = random_frames(camera, SCENES, rng)
    return [
        replace(scenes[i % SCENES], time_ns=i * PERIOD_NS - LATENCY_NS, frame_id=i // 2)
        for i in range(count)
    ]


def row(watch: Stopwatch) -> dict[str, float]:
    """Percentiles, and how much of a core such calls at 100 Hz take."""
    share = float(np.mean(watch.cpu_us)) / (1e-3 * PERIOD_NS)
    return {**watch.percentiles(), "core_share": round(share, 4)}


def over(watch: Stopwatch, alone: Stopwatch) -> float:
    """Ratio of the medians of processor time."""
    return round(float(np.median(watch.cpu_us) / np.median(alone.cpu_us)), 2)


def network_alone(path: Path) -> Callable[[], None]:
    """A call of ONNX Runtime for one robot, on zeros."""
    session = ModelFile(path).session
    binding = session.io_binding()
    for value in session.get_inputs():
        shape = [size if isinstance(size, int) else 1 for size in value.shape]
        binding.bind_cpu_input(value.name, np.zeros(shape, np.float32))
    for value in session.get_outputs():
        binding.bind_output(value.name)
    return partial(session.run_with_iobinding, binding)


def one_robot(
    network: HeightmapNetwork,
    states: Sequence[RobotState],
    images: Sequence[DepthFrame],
    alone: Callable[[], None],
) -> tuple[Stopwatch, Stopwatch, Stopwatch]:
    """Single steps with images of the model's own size, calls of `alone` between them, and the
    network with copies of its inputs and outputs.
    """
    service, watches = HeightmapService(network), [Stopwatch(WARM_UP) for _ in range(3)]
    step, beside, copied = watches
    image, zero = model_image(np.zeros((1, 48, 16), np.uint16)), np.zeros(1)
    features = np.zeros((1, len(PROPRIOCEPTION)), np.float32)
    hidden = np.zeros((1, network.hidden_size), np.float32)
    for state, frame in zip(states, images, strict=True):
        step(service.step, state, frame if state.step % 2 == 0 else None, state.time_ns)
        beside(alone)
        copied(network.tick, image, zero, zero == 0.0, features, hidden)
        alone()
    return step, beside, copied


def fleet(
    network: HeightmapNetwork,
    robots: int,
    states: Sequence[RobotState],
    images: Sequence[DepthFrame],
) -> Stopwatch:
    """Steps of so many robots together."""
    names = [f"robot/{i}" for i in range(robots)]
    service, watch = FleetService(network, names), Stopwatch(skip=WARM_UP)
    for state, frame in zip(states, images, strict=True):
        taken = frame if state.step % 2 == 0 else None
        boot = None if taken is None else b"camera"
        arrival = RobotRequest(
            state=state, robot_boot=b"robot", frame=taken, camera_boot=boot, now_ns=state.time_ns
        )
        watch(service.step, dict.fromkeys(names, arrival))
    return watch
