"""The model check: loads a model in a process of its own and runs it.

A crash here cannot crash a robot's service.

    python -m saltus.heightmap.service.model_check FILE < robot.toml

The robot is the one that is served. Prints the model's id; a model that cannot be used ends in one
line on stderr and exit code 2.
"""

import resource
import sys
from pathlib import Path

import numpy as np

from saltus.depth import MODEL_CAMERA, depth_frame
from saltus.errors import ModelError, SaltusError
from saltus.heightmap.level_robot import LevelRobot
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.service import HeightmapService
from saltus.robots.robot import Robot
from saltus.tuning import stand_back
from saltus.wire.messages import DepthFrame, HeightmapStatus
from saltus.wire.topics import CAMERA_LATENCY_S, CAMERA_PERIOD_S

WARM_TICKS = 200
"""After the warm-up: two seconds, in which a hidden state that grows and a frozen output are
noticed."""
MEMORY_BYTES = 8 << 30  # of addresses, most of which ONNX Runtime never touches
CPU_S = 20


def checked_model(robot: Robot, path: Path) -> HeightmapNetwork:
    """Loads a model and runs it in a service, on synthetic images of a robot that stands.

    Raises:
        ModelError: it is damaged, does not fit, or the service does not become and stay OK with it.
    """
    network = HeightmapNetwork(robot, path)
    service = HeightmapService(network)
    rng = np.random.default_rng(0)
    frames = [_frame(i, rng) for i in range(network.warmup_frames + WARM_TICKS)]
    for tick, (state, frame) in enumerate(
        zip(LevelRobot().states(robot, frames), frames, strict=True)
    ):
        answer = service.step(state, frame, state.time_ns)
        expected = HeightmapStatus.OK if tick >= network.warmup_frames else HeightmapStatus.WARMING
        if answer.status > expected or service.bad_outputs:
            found = answer.status.name if answer.status > expected else "not plausible"
            raise ModelError(
                f"model {path} fails its check: after {tick} good images the heightmap is {found}"
            )
    return network


def _frame(index: int, rng: np.random.Generator) -> DepthFrame:
    depth = rng.integers(300, 2500, (MODEL_CAMERA.height, MODEL_CAMERA.width)).astype(np.uint16)
    time_ns = round(1e9 * (CAMERA_PERIOD_S * index - CAMERA_LATENCY_S))
    return depth_frame(MODEL_CAMERA, depth, time_ns=time_ns, frame_id=index)


def main() -> int:
    """Tries the model of the command line."""
    stand_back()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S))
    try:
        robot = Robot.from_toml(sys.stdin.read())
        sys.stdout.write(f"{checked_model(robot, Path(sys.argv[1])).model_id}\n")
    except SaltusError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
