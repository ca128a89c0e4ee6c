"""Speed of the depth camera: frames per second of every back end that this machine has, and what they leave in memory.

python benchmarks/render.py [--backend NAME] [--noise NAME] [--seconds S] [--batch N] [--frames N] [--json]: ends with
one line of JSON, whose rows say by which back end ("backend") what was rendered ("legs": terrain and the 12 shapes of
the legs, which are in view in half of the frames; else terrain only), with which noise ("native": the sensor's 80 x 240
pixels with their true second view, then pooled to 16 x 48; "fast": the chain for training, three rays a pixel of the
model), and the growth of the processes over 20,000 frames of 16 x 48, or of other images with as many pixels. Lines
before the JSON name the processor time of a frame, too: on a shared machine it is the steadier one, and cores over it
are the frames per second of a machine that is at rest.
"""

import argparse
import itertools
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # before this folder, whose render.py is this file

from saltus import go1
from saltus.config import TerrainConfig
from saltus.depth import D435I, MODEL_CAMERA, Intrinsics, model_image
from saltus.render.backends import make_renderer, present
from saltus.render.stereo.model_view import COLUMNS, ROWS
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.terrain.curriculum import make_terrain
from saltus.wire.messages import DepthFrame, Floats

TERRAIN = make_terrain(TerrainConfig(terrain="stairs", rise_m=0.06))
WIDE = Intrinsics(width=60, height=48, fx=42.28, fy=42.28, cx=30.0, cy=24.0)  # the model's pixels, a wider view
CAMERAS = (MODEL_CAMERA, WIDE, D435I)
GROWTH_FRAMES = 20_000
# Images of the model's camera in a batch, of others as many as have as many pixels; pyrender makes one after the other
BATCH = {"embree": 1024, "pyrender": 32, "warp": 8192}
NATIVE = 5  # pixels of the sensor for each of the model's, along both axes
NATIVE_BATCH = 56
WARMING = 3  # calls: what is compiled and cached is there
SETTLING = 8  # calls

Poses = tuple[Any, Any, Any]


@dataclass(frozen=True, kw_only=True)
class Case:
    """What one row measures."""

    backend: str
    camera: Intrinsics
    legs: bool
    noise: str = "none"
    batch: int

    @property
    def size(self) -> str:
        """As the rows name it: of the image that gets the noise."""
        scale = NATIVE if self.noise == "native" else 1
        return f"{scale * self.camera.width}x{scale * self.camera.height}"

    @property
    def frames_of_model(self) -> float:
        """As many as have the pixels of one frame of this."""
        return self.camera.width * self.camera.height / (MODEL_CAMERA.width * MODEL_CAMERA.height)


def poses(count: int) -> tuple[Floats, Floats, Floats]:
    """Robots along the course, somewhat turned; every second one stretches its legs into the picture."""
    rng = np.random.default_rng(0)
    position = rng.uniform([0.0, -0.1, 0.3], [4.0, 0.1, 0.6], (count, 3))
    position[:, 2] += TERRAIN.height_at(position[:, 0], position[:, 1])
    quaternion = quaternion_from_roll_pitch_yaw(*rng.uniform(-0.2, 0.2, (3, count)))
    joints = go1.STAND_POSE + rng.uniform(-0.3, 0.3, (count, 12))
    ahead = joints.reshape(count, 4, 3)[::2]
    ahead[..., 0] = go1.SIDE * rng.uniform(-0.86, -0.65, ahead.shape[:2])
    ahead[..., 1] = rng.uniform(-0.68, -0.2, ahead.shape[:2])
    ahead[..., 2] = rng.uniform(-1.2, -0.9, ahead.shape[:2])
    return position, quaternion, joints


def cases(backend: str, images: int) -> Iterator[Case]:
    """All rows of a back end, for batches of so many images of the model's camera."""
    for camera in CAMERAS:
        pixels = images * MODEL_CAMERA.width * MODEL_CAMERA.height
        batch = max(1, pixels // (camera.width * camera.height))
        for legs in (False, True):
            yield Case(backend=backend, camera=camera, legs=legs, batch=batch)
    for legs in (False, True):
        if backend == "embree":
            yield Case(backend=backend, camera=MODEL_CAMERA, legs=legs, noise="native", batch=min(images, NATIVE_BATCH))
        if backend in ("embree", "warp"):
            yield Case(backend=backend, camera=MODEL_CAMERA, legs=legs, noise="fast", batch=images)


def exposure(case: Case) -> tuple[Callable[[], object], Callable[[], object]]:
    """Something that makes one batch of images, and something that frees what it needs."""
    if case.backend == "warp":
        return warp_exposure(case)
    robots = poses(case.batch)
    if case.noise != "none":
        return noisy_exposure(case, robots)
    renderer = make_renderer(case.backend, TERRAIN, case.camera, legs=case.legs)
    return lambda: renderer.render_batch(*robots), renderer.close


def noisy_exposure(case: Case, robots: Poses) -> tuple[Callable[[], object], Callable[[], object]]:
    """The chain of the sensor's own pixels, or that for training, with a process on each core."""
    from saltus.render.stereo_processes import StereoProcesses

    rows, columns = (NATIVE, NATIVE) if case.noise == "native" else (ROWS, COLUMNS)
    rng = np.random.default_rng(0)
    cameras = StereoProcesses(
        TERRAIN, legs=case.legs, rows=rows, columns=columns, count=case.batch, rng=rng, processes=cores()
    )
    instants = instants_s()
    return lambda: cameras.step(*robots, next(instants)), cameras.close


def warp_exposure(case: Case) -> tuple[Callable[[], object], Callable[[], object]]:
    """On the GPU, where there is one, from torch's tensors to torch's tensors; ends when the device has finished."""
    import torch
    import warp

    from saltus.render.stereo.camera import StereoConfig
    from saltus.render.stereo.model_view import sampled_model_camera
    from saltus.render.stereo.optics import Optics
    from saltus.render.stereo_torch import TorchStereo
    from saltus.render.warp import WarpRenderer

    view = case.camera if case.noise == "none" else sampled_model_camera(ROWS, COLUMNS)
    caster = WarpRenderer(TERRAIN, view, legs=case.legs).caster
    robots = [torch.as_tensor(array, dtype=torch.float32, device=caster.device) for array in poses(case.batch)]
    optics = Optics.of(view)
    cameras = TorchStereo(StereoConfig(), optics, caster.device)
    state = cameras.init(case.batch, np.random.default_rng(0)) if case.noise != "none" else ()
    instants = instants_s()

    def expose() -> object:
        nonlocal state
        if case.noise == "none":
            images = warp.to_torch(caster.cast(*robots))
        else:
            times = torch.full((case.batch,), next(instants), dtype=torch.float64, device=caster.device)
            depth, hidden = map(warp.to_torch, caster.cast_pair(*robots, baseline_m=optics.baseline_m))
            images, state = cameras.step_pooled(depth, hidden, times, state, ROWS, COLUMNS)
        warp.synchronize_device(caster.device)
        return images

    return expose, lambda: None


def instants_s() -> Iterator[float]:
    """Capture times [s], 20 ms apart: a frame that comes again would be less work."""
    return itertools.count(0.0, 0.02)


def measure(case: Case, seconds: float, growth_frames: int = GROWTH_FRAMES) -> dict[str, object]:
    """One row; prints a line about it."""
    expose, close = exposure(case)
    growing = int(np.ceil(growth_frames / case.frames_of_model / case.batch))
    for _ in range(WARMING):
        expose()
    calls, begin, processor = 0, time.perf_counter(), processor_s()
    while time.perf_counter() - begin < seconds:
        expose()
        calls += 1
    frames = calls * case.batch
    wall, processor = time.perf_counter() - begin, processor_s() - processor
    before = settled_mb(expose)
    for _ in range(growing):
        expose()
    growth = settled_mb(expose) - before
    close()
    scene = "with legs" if case.legs else "terrain"
    print(
        f"{case.backend:9}{case.size:9}{scene:10} noise {case.noise:7} batch {case.batch:5}: {frames / wall:9.0f} /s, "
        f"{1e6 * processor / frames:8.1f} us of processor a frame, growth {growth:.2f} MB",
        flush=True,
    )
    return {
        "backend": case.backend,
        "size": case.size,
        "terrain": TERRAIN.kind,
        "legs": case.legs,
        "noise": case.noise,
        "batch": case.batch,
        "fps": round(frames / wall, 1),
        "rss_growth_mb": round(growth, 2),
    }


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


def own_processes() -> list[Path]:
    """Where the system tells about this process and those that it has started."""
    return [Path(f"/proc/{pid}") for pid in (os.getpid(), *(p.pid for p in multiprocessing.active_children()))]


def resident_mb() -> float:
    """Memory of this process and of those that it has started."""
    pages = sum(int((folder / "statm").read_text().split()[1]) for folder in own_processes())
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def settled_mb(expose: Callable[[], object]) -> float:
    """The most memory after any of some calls: the heap gives pages back at one and takes them again at another."""
    return max((expose(), resident_mb())[1] for _ in range(SETTLING))


def processor_s() -> float:
    """Processor time that this process and those that it has started have used."""
    fields = [(folder / "stat").read_text().rpartition(")")[2].split() for folder in own_processes()]
    return sum(int(f[11]) + int(f[12]) for f in fields) / os.sysconf("SC_CLK_TCK")


def crop_ms(camera: Intrinsics, seconds: float) -> float:
    """Time to make the model's image of a frame."""
    depth = np.random.default_rng(0).integers(0, 4000, (camera.height, camera.width)).astype(np.uint16)
    frame = DepthFrame(
        time_ns=0, frame_id=0, depth=depth, depth_unit_m=0.001, fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy
    )
    model_image(frame)
    calls, begin = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - begin) < seconds:
        model_image(frame)
        calls += 1
    return round(1e3 * elapsed / calls, 4)


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--backend", choices=list(BATCH), help="only this one; all that are present by default")
    parser.add_argument("--noise", choices=["none", "native", "fast"], help="only these rows; all by default")
    parser.add_argument("--seconds", type=float, default=1.0, help="of each measurement")
    parser.add_argument("--batch", type=int, help="images of 16x48 in a batch; what suits each back end by default")
    parser.add_argument(
        "--frames", type=int, default=GROWTH_FRAMES, help="of 16x48 over which the growth of memory is measured"
    )
    parser.add_argument("--json", action="store_true", help="the last line is JSON with or without it")
    given = parser.parse_args()
    rows = [
        measure(case, given.seconds, given.frames)
        for backend in ([given.backend] if given.backend else present())
        for case in cases(backend, given.batch or BATCH[backend])
        if given.noise in (None, case.noise)
    ]
    crops = {f"{c.width}x{c.height}": crop_ms(c, 0.2 * given.seconds) for c in (MODEL_CAMERA, D435I)}
    print(json.dumps({"rows": rows, "crop_ms": crops}))


if __name__ == "__main__":
    main()
