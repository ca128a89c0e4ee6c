"""Speed of the depth camera: frames per second of every back end that this machine has,
and growth of memory.

A row says by which back end ("backend") what was rendered ("legs": terrain and the 12 shapes of the
legs, which are in view in half of the frames; else terrain only), with which noise ("native": the
sensor's 80 x 240 pixels with their true second view, then pooled to 16 x 48; "fast": the chain for
training, three rays a pixel of the model), and the growth of the processes over 20,000 frames of 16
x 48, or of other images with as many pixels. The processor time of a frame is the steadier figure
on a shared machine; cores over it are the frames per second of a machine that is at rest.

    saltus bench render
    saltus bench render -- --backend warp --seconds 2
"""

import contextlib
import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from benchmarks._command import Command, progress
from benchmarks._measuring import own_processes, processor_s, random_frames, resident_mb
from saltus.arrays import Floats
from saltus.config import TerrainConfig
from saltus.depth import D435I, MODEL_CAMERA, Intrinsics, model_image, supersampled_model_camera
from saltus.effects.effect import map_arrays
from saltus.errors import SaltusError
from saltus.render.backends import NAMES, has_driver, make_renderer, make_stereo
from saltus.render.camera import RobotCamera
from saltus.render.stereo.camera import StereoCamera, StereoConfig
from saltus.render.stereo.model_view import COLUMNS, ROWS, pool_valid
from saltus.render.stereo.optics import StereoOptics
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.terrain.curriculum import make_terrain

ROBOT = load_robot(DEFAULT_ROBOT)
TERRAIN = make_terrain(TerrainConfig(terrain="stairs", rise_m=0.06))
# The model's pixels, a wider view
WIDE = Intrinsics(width=60, height=48, fx=42.28, fy=42.28, cx=30.0, cy=24.0)
CAMERAS = (MODEL_CAMERA, WIDE, D435I)
# Images of the model's camera in a batch, of others as many as have as many pixels; pyrender makes
# one after the other
BATCH = {"embree": 1024, "pyrender": 32, "warp": 8192}
NATIVE = 5  # pixels of the sensor for each of the model's, along both axes
NATIVE_BATCH, FAST_BATCH = 7, 64  # their arrays stay in the processor's cache
WARMING = 3  # calls: what is compiled and cached is there
SETTLING = 8  # calls

Poses = tuple[Any, Any, Any]


def present() -> list[str]:
    """Names of the back ends that can be loaded;
    Warp only where there is a GPU, without which it is no use.
    """
    found: list[str] = []
    for name in NAMES:
        if name == "auto" or (name == "warp" and not has_driver()):
            continue
        with contextlib.suppress(SaltusError):
            make_renderer(name, TERRAIN, RobotCamera.on(ROBOT))
            found.append(name)
    return found


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    backend: Literal["embree", "pyrender", "warp"] | None = None
    """Only this one; all that are present by default."""
    noise: Literal["none", "native", "fast"] | None = None
    """Only these rows; all by default."""
    seconds: float = 1.0
    """Seconds of each measurement."""
    batch: int | None = None
    """Images of 16x48 in a batch; what suits each back end by default."""
    frames: int = 20_000
    """Frames of 16x48 over which the growth of memory is measured."""

    def measure(self) -> dict[str, Any]:
        rows = [
            case
            for backend in ([self.backend] if self.backend else present())
            for case in cases(backend, self.batch or BATCH[backend])
            if self.noise in (None, case.noise)
        ]
        crops = {
            f"{c.width}x{c.height}": crop_ms(c, 0.2 * self.seconds) for c in (MODEL_CAMERA, D435I)
        }
        return {
            "rows": [measure(case, self.seconds, self.frames) for case in progress(rows)],
            "crop_ms": crops,
        }


@dataclass(frozen=True, kw_only=True)
class Case:
    """A row and what it measures."""

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
    """Robots along the course, somewhat turned.

    Every second one stretches its legs into the picture.
    """
    rng = np.random.default_rng(0)
    position = rng.uniform([0.0, -0.1, 0.3], [4.0, 0.1, 0.6], (count, 3))
    position[:, 2] += TERRAIN.height_at(position[:, 0], position[:, 1])
    quaternion = quaternion_from_roll_pitch_yaw(*rng.uniform(-0.2, 0.2, (3, count)))
    joints = ROBOT.stand_pose + rng.uniform(-0.3, 0.3, (count, 12))
    ahead = joints.reshape(count, 4, 3)[::2]
    ahead[..., 0] = ROBOT.side * rng.uniform(-0.86, -0.65, ahead.shape[:2])
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
        if backend != "warp":
            yield Case(
                backend=backend,
                camera=MODEL_CAMERA,
                legs=legs,
                noise="native",
                batch=min(images, NATIVE_BATCH),
            )
        batch = images if backend == "warp" else min(images, FAST_BATCH)
        yield Case(backend=backend, camera=MODEL_CAMERA, legs=legs, noise="fast", batch=batch)


def exposure(case: Case) -> Callable[[], object]:
    """Something that makes one batch of images."""
    if case.backend == "warp":
        return warp_exposure(case)
    robots = poses(case.batch)
    if case.noise != "none":
        return noisy_exposure(case, robots)
    renderer = make_renderer(
        case.backend, TERRAIN, RobotCamera.on(ROBOT, case.camera, legs=case.legs)
    )
    return lambda: renderer.render_batch(*robots)


def noisy_exposure(case: Case, robots: Poses) -> Callable[[], object]:
    """The chain of the sensor's own pixels, or that for training, in one process."""
    rows, columns = (NATIVE, NATIVE) if case.noise == "native" else (ROWS, COLUMNS)
    view, instants = supersampled_model_camera(rows, columns), instants_s()
    optics = StereoOptics.of(view)
    pair = make_stereo(case.backend, TERRAIN, optics, RobotCamera.on(ROBOT, view, legs=case.legs))
    cameras = StereoCamera(StereoConfig(), optics)
    state = cameras.init((case.batch,), np.random.default_rng(0))

    def expose() -> object:
        nonlocal state
        depth, hidden = pair.render_pair_batch(*robots)
        image, state = cameras.step(depth, hidden, np.full(case.batch, next(instants)), state)
        return pool_valid(image.depth, rows, columns)

    return expose


def warp_exposure(case: Case) -> Callable[[], object]:
    """On the GPU, where there is one, from torch's tensors to torch's tensors.

    Ends when the device has finished.
    """
    import torch
    import warp

    from saltus.render.stereo_torch import KorniaWindows
    from saltus.render.warp import WarpRenderer

    view = case.camera if case.noise == "none" else supersampled_model_camera(ROWS, COLUMNS)
    caster = WarpRenderer(TERRAIN, RobotCamera.on(ROBOT, view, legs=case.legs)).caster
    robots = [
        torch.as_tensor(array, dtype=torch.float32, device=caster.device)
        for array in poses(case.batch)
    ]
    optics = StereoOptics.of(view)
    cameras = StereoCamera(StereoConfig(), optics, KorniaWindows())
    drawn = cameras.init((case.batch,), np.random.default_rng(0)) if case.noise != "none" else ()
    state = map_arrays(lambda array: torch.as_tensor(array, device=caster.device), drawn)
    instants = instants_s()

    def expose() -> object:
        nonlocal state
        if case.noise == "none":
            images = warp.to_torch(caster.cast(*robots))
        else:
            times = torch.full(
                (case.batch,), next(instants), dtype=torch.float64, device=caster.device
            )
            depth, hidden = map(
                warp.to_torch, caster.cast_pair(*robots, baseline_m=optics.baseline_m)
            )
            image, state = cameras.step(depth, hidden, times, state)
            images = pool_valid(image.depth, ROWS, COLUMNS)
        warp.synchronize_device(caster.device)
        return images

    return expose


def instants_s() -> Iterator[float]:
    """Capture times [s], 20 ms apart: a frame that comes again would be less work."""
    return itertools.count(0.0, 0.02)


def measure(case: Case, seconds: float, growth_frames: int) -> dict[str, object]:
    """One row."""
    expose = exposure(case)
    growing = int(np.ceil(growth_frames / case.frames_of_model / case.batch))
    for _ in range(WARMING):
        expose()
    calls, begin, processor = 0, time.perf_counter(), processor_s(own_processes())
    while calls == 0 or time.perf_counter() - begin < seconds:
        expose()
        calls += 1
    frames = calls * case.batch
    wall, processor = time.perf_counter() - begin, processor_s(own_processes()) - processor
    before = settled_mb(expose)
    for _ in range(growing):
        expose()
    growth = settled_mb(expose) - before
    return {
        "backend": case.backend,
        "size": case.size,
        "terrain": TERRAIN.kind,
        "legs": case.legs,
        "noise": case.noise,
        "batch": case.batch,
        "fps": round(frames / wall, 1),
        "processor_us": round(1e6 * processor / frames, 1),
        "rss_growth_mb": round(growth, 2),
    }


def settled_mb(expose: Callable[[], object]) -> float:
    """The most memory after any of some calls:
    the heap gives pages back at one and takes them again at another.
    """
    return max((expose(), resident_mb(own_processes()))[1] for _ in range(SETTLING))


def crop_ms(camera: Intrinsics, seconds: float) -> float:
    """Time to make the model's image of a frame."""
    frame = random_frames(camera, 1, np.random.default_rng(0))[0]
    model_image(frame.depth, camera)
    calls, begin = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - begin) < seconds:
        model_image(frame.depth, camera)
        calls += 1
    return round(1e3 * elapsed / calls, 4)
