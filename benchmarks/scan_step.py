"""Time that one image and one state take the service of any grid on one core,
beside its network alone.

OMP_NUM_THREADS=1 saltus bench scan_step
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks._command import Command
from saltus.arrays import Singles
from saltus.depth import D435I, depth_frame
from saltus.grid import SCAN
from saltus.heightmap.scan.network_inputs import MEASURED, MEMORY, NUMBERS, ScanInputs
from saltus.heightmap.scan.own_body import RobotBody
from saltus.heightmap.scan.predictor import ScanNetwork
from saltus.heightmap.scan.scan_camera import ScanCamera
from saltus.heightmap.service.scan import FIRST, ScanRig, ScanService
from saltus.render.camera import ray_directions
from saltus.robots.loading import load_robot
from saltus.robots.mount import Mount
from saltus.robots.robot import Robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.states import standing_state
from saltus.used_networks import model_path
from saltus.wire.messages import DepthFrame, Heightmap, RobotState

STEP_NS, LATENCY_NS = 10_000_000, 50_000_000
EVERY = 3
"""Steps from one image to the next: 33 Hz."""
SPEED_MPS = 0.5


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    """Milliseconds of one core for an image with map and network,
    for the network alone, and for a state.

    A robot goes over level ground; its camera is a D435i of 424x240 pixels, its own body is taken
    out.
    """

    images: int = 40
    """Images of the run."""

    def measure(self) -> dict[str, Any]:
        """Medians of processor time, which other programs disturb less than the clock's,
        and the least.
        """
        robot, network = load_robot(DEFAULT_ROBOT), ScanNetwork(model_path("scan"))
        mount = Mount.of(robot)
        rig = ScanRig(
            grid=SCAN, cameras={FIRST: ScanCamera(mount)}, dialect="isaaclab",
            robot=robot, body=RobotBody(robot),
        )  # fmt: skip
        service, inputs, pixels = ScanService(network, rig), _inputs(network), _level(robot, mount)
        image, alone, state = list[float](), list[float](), list[float]()
        for step in range(EVERY * self.images):
            now = _state(robot, step)
            frame = None
            if step % EVERY == EVERY - 1:
                frame = depth_frame(
                    D435I, pixels, time_ns=now.time_ns - LATENCY_NS, frame_id=step // EVERY
                )
                alone.append(_ms(partial(network, inputs)))
            (state if frame is None else image).append(_ms(partial(_answered, service, now, frame)))
        times = {"image_ms": image, "network_alone_ms": alone, "state_ms": state}
        table = {name: round(float(np.median(values)), 3) for name, values in times.items()}
        least = {f"least_{name}": round(float(np.min(values)), 3) for name, values in times.items()}
        return (
            table
            | least
            | {"image_over_network": round(table["image_ms"] / table["network_alone_ms"], 2)}
        )


def _answered(service: ScanService, state: RobotState, frame: DepthFrame | None) -> Heightmap:
    return service.step(state, frame, state.time_ns)


def _state(robot: Robot, step: int) -> RobotState:
    velocity = np.array([SPEED_MPS, 0.0, 0.0])
    time_ns = LATENCY_NS + step * STEP_NS
    return replace(
        standing_state(robot), step=step, time_ns=time_ns, velocity_base_in_world=velocity
    )


def _level(robot: Robot, mount: Mount) -> np.ndarray[Any, np.dtype[np.uint16]]:
    """Depth of level ground [mm], 0 beyond 6 m."""
    fall = (ray_directions(D435I) @ mount.rotation.T)[..., 2]
    height = robot.stand_height + float(np.asarray(mount.position)[2])
    depth = np.where(fall < -height / 6.0, -height / np.minimum(fall, -1e-6), 0.0)
    return np.rint(1e3 * depth).astype(np.uint16)


def _ms(call: Callable[[], Any]) -> float:
    began = time.process_time()
    call()
    return 1e3 * (time.process_time() - began)


def _inputs(network: ScanNetwork) -> ScanInputs:
    side = network.settings.side
    shapes = [(side, side), (len(MEASURED), side, side), (len(MEMORY), side, side), (len(NUMBERS),)]
    planes: list[Singles] = [np.zeros((1, *shape), np.float32) for shape in shapes]
    return ScanInputs(*planes)
