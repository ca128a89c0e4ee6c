"""Speed of the depth camera: frames per second of both back ends, and what 1,000 frames leave behind in memory.

python -m benchmarks.render: prints one line of JSON.
"""

import json
import time
from collections.abc import Callable

import numpy as np
import psutil

from render.backends import make_renderer
from saltus import go1
from saltus.config import TerrainConfig
from saltus.depth import D435I, MODEL_CAMERA, Intrinsics, model_image
from saltus.kinematics import quaternion_from_roll_pitch_yaw
from saltus.messages import DepthFrame, Floats
from saltus.terrain.curriculum import make_terrain

SECONDS = 1.0  # of each measurement
BATCH = 256
GROWTH_FRAMES = 1000


def rate(action: Callable[[int], object], frames_per_call: int = 1) -> float:
    """Frames per second of an action that is given the number of its call."""
    action(0)
    calls, begin = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - begin) < SECONDS:
        action(calls)
        calls += 1
    return round(calls * frames_per_call / elapsed, 1)


def poses(count: int) -> tuple[Floats, Floats, Floats]:
    """Robots that stand along the course, somewhat turned; with a wide camera their legs are in view."""
    rng = np.random.default_rng(0)
    position = rng.uniform([0.0, -0.1, 0.25], [1.0, 0.1, 0.4], (count, 3))
    quaternion = quaternion_from_roll_pitch_yaw(*rng.uniform(-0.2, 0.2, (3, count)))
    return position, quaternion, go1.STAND_POSE + rng.uniform(-0.3, 0.3, (count, 12))


def measure(name: str, camera: Intrinsics, legs: bool) -> dict[str, float]:
    """Rates of one back end, and its growth."""
    renderer = make_renderer(name, make_terrain(TerrainConfig(terrain="stairs")), camera, legs=legs)
    position, quaternion, joints = poses(BATCH)
    single = rate(lambda k: renderer.render(position[k % BATCH], quaternion[k % BATCH], joints[k % BATCH]))
    batched = rate(lambda _: renderer.render_batch(position, quaternion, joints), BATCH)
    result = {"single_fps": single, f"batch_{BATCH}_fps": batched}
    if camera is MODEL_CAMERA:
        before = psutil.Process().memory_info().rss
        for k in range(GROWTH_FRAMES):
            renderer.render(position[k % BATCH], quaternion[k % BATCH], joints[k % BATCH])
        result["rss_growth_mb"] = round((psutil.Process().memory_info().rss - before) / 1e6, 2)
    renderer.close()
    return result


def crop_ms(camera: Intrinsics) -> float:
    """Time to make the model's image of a frame."""
    depth = np.random.default_rng(0).integers(0, 4000, (camera.height, camera.width)).astype(np.uint16)
    frame = DepthFrame(
        time_ns=0, frame_id=0, depth=depth, depth_unit_m=0.001, fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy
    )
    return round(1e3 / rate(lambda _: model_image(frame)), 4)


def main() -> None:
    """Measures and prints."""
    result: dict[str, object] = {}
    for name in ("embree", "pyrender"):
        for camera in (MODEL_CAMERA, D435I):
            for legs in (False, True):
                scene = "with_legs" if legs else "terrain"
                result[f"{name}_{camera.width}x{camera.height}_{scene}"] = measure(name, camera, legs)
    wide = Intrinsics(width=640, height=480, fx=390.4, fy=390.4, cx=320.0, cy=240.0)
    for camera in (MODEL_CAMERA, D435I, wide):
        result[f"crop_{camera.width}x{camera.height}_ms"] = crop_ms(camera)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
