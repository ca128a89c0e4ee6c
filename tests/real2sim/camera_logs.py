"""Logs of a depth camera made from formulas:
rays against boxes by Open3D, motions of the base by hand.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import open3d
from scipy.ndimage import gaussian_filter
from scipy.signal import lfilter

from saltus.arrays import Floats
from saltus.recordings.run_log import DepthTable, JointTable, LogTable, RunLog
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix

HEIGHT, WIDTH, FOCAL = 48, 64, 40.0
POSITION, PITCH, LATENCY_S = (0.272, 0.0075, 0.092), 0.52, 0.05
FLOOR_NOISE = 1.3e-3

FLAT: tuple[Any, ...] = ()
STEP = ({"center": [1.6, 0.0, 0.06], "size": [1.0, 4.0, 0.12]},)
WALL = ({"center": [1.9, 0.0, 0.5], "size": [0.2, 4.0, 1.0]},)
POST = (
    {"center": [1.0, -0.05, 0.3], "size": [0.1, 0.16, 0.6]},
    {"center": [2.2, 0.0, 0.5], "size": [0.2, 6.0, 1.0]},
)

Motion = Callable[[Floats], tuple[Floats, Floats, Floats]]
"""Time [s] to x [m], height above standing [m] and pitch [rad]."""


def chirp(t: Floats) -> tuple[Floats, Floats, Floats]:
    phase = 2 * np.pi * (0.3 * t + 0.5 * 0.25 * t**2)
    return 0 * t, 0.03 * np.sin(phase), 0.05 * np.sin(1.3 * phase)


def sine(t: Floats) -> tuple[Floats, Floats, Floats]:
    return 0 * t, 0.03 * np.sin(2 * np.pi * t), 0 * t


def rocking(t: Floats) -> tuple[Floats, Floats, Floats]:
    return 0 * t, 0 * t, 0.12 * np.sin(2 * np.pi * 1.5 * t) + 0.05 * np.sin(2 * np.pi * 0.4 * t)


def still(t: Floats) -> tuple[Floats, Floats, Floats]:
    moved = np.clip((t - 9.5) / 1.0, 0.0, 1.0)
    return 0.4 * moved**2 * (3.0 - 2.0 * moved), 0 * t, 0 * t


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What is hidden in a log."""

    latency: float = LATENCY_S
    alpha: float = 1.0
    pitch: float = 0.0
    height: float = 0.0
    fov: float = 1.0
    scale: float = 1.0
    bias: float = 0.0
    subpixel: float = 0.0
    holes: int = 0
    fill: int = 0
    clip: float = np.inf
    drop: float = 0.0
    jitter: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """One log."""

    motion: Motion = chirp
    boxes: tuple[Any, ...] = FLAT
    truth: Truth = field(default_factory=Truth)
    duration_s: float = 20.0
    rate_hz: float = 30.0
    noise: float = FLOOR_NOISE
    seed: int = 0
    has_capture: bool = False
    is_rough: bool = False
    """Noise that is correlated in the image and in time, mixed pixels at edges, a base that is
    measured with noise."""


def camera_log(recipe: Recipe) -> RunLog:
    """Renders a log."""
    rng, truth = np.random.default_rng(recipe.seed), recipe.truth
    capture_s = 1.0 + np.arange(0.2, recipe.duration_s - 0.2, 1.0 / recipe.rate_hz)
    depth = rendered(recipe, capture_s)
    arrival_s = capture_s + truth.latency + truth.jitter * rng.uniform(-1, 1, len(capture_s))
    kept = rng.random(len(capture_s)) >= truth.drop
    depth = measured(depth[kept], recipe, rng)
    base_s = 1.0 + np.arange(0.0, recipe.duration_s, 0.005)
    joints_s = 1.0 + np.arange(0.0, recipe.duration_s, 0.002)
    base = np.concatenate([*pose(recipe.motion, base_s), np.zeros((len(base_s), 3))], axis=1)
    if recipe.is_rough:
        base[:, :7] += 3e-4 * rng.standard_normal((len(base_s), 7))
    return RunLog(
        meta=meta(recipe),
        joints=JointTable(
            time_s=joints_s, q=np.zeros((len(joints_s), 12)), q_des=np.zeros((len(joints_s), 12))
        ),
        base=LogTable(time_s=base_s, values=base),
        depth=DepthTable(
            arrival_s=arrival_s[kept],
            capture_s=capture_s[kept] if recipe.has_capture else None,
            frame_id=np.flatnonzero(kept),
            depth_mm=depth,
        ),
    )


def meta(recipe: Recipe) -> dict[str, Any]:
    count = 6
    edges = 1.0 + np.linspace(0.0, recipe.duration_s, count + 1)
    return {
        "schema": "saltus-run/1",
        "robot": "go1",
        "base": "free",
        "joints": [f"j{i}" for i in range(12)],
        "terrain": list(recipe.boxes) or "flat",
        "segments": [
            {"name": f"s{k}", "t0": edges[k], "t1": edges[k + 1], "condition": f"c{k // 2}"}
            for k in range(count)
        ],
        "camera": {
            "fx": FOCAL,
            "fy": FOCAL,
            "cx": WIDTH / 2,
            "cy": HEIGHT / 2,
            "width": WIDTH,
            "height": HEIGHT,
            "position": list(POSITION),
            "pitch": PITCH,
            "rate": recipe.rate_hz,
            "latency": LATENCY_S,
            "range_max": 4.0,
        },
    }


def pose(motion: Motion, time_s: Floats) -> tuple[Floats, Floats]:
    x, height, pitch = motion(time_s - 1.0)
    quaternion = quaternion_from_roll_pitch_yaw(0 * pitch, pitch, 0 * pitch)
    return np.stack([x, 0 * x, 0.3 + height], axis=-1), quaternion


def rendered(recipe: Recipe, capture_s: Floats) -> Floats:
    truth = recipe.truth
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    for low, high in [((-50, -50, -1), (50, 50, 0)), *(corners(box) for box in recipe.boxes)]:
        mesh = open3d.t.geometry.TriangleMesh.create_box(*(np.subtract(high, low).tolist()))
        scene.add_triangles(mesh.translate(open3d.core.Tensor(np.asarray(low, dtype=np.float32))))
    c, s = np.cos(PITCH + truth.pitch), np.sin(PITCH + truth.pitch)
    axes = np.array([[0.0, -s, c], [-1.0, 0.0, 0.0], [0.0, -c, -s]])
    v, u = np.meshgrid(np.arange(HEIGHT) + 0.5, np.arange(WIDTH) + 0.5, indexing="ij")
    looks = np.stack(
        [
            truth.fov * (u - WIDTH / 2) / FOCAL,
            truth.fov * (v - HEIGHT / 2) / FOCAL,
            np.ones_like(u),
        ],
        axis=-1,
    )
    position, quaternion = pose(recipe.motion, capture_s)
    rotation = rotation_matrix(quaternion)
    origin = position + rotation @ (np.array(POSITION) + np.array([0, 0, truth.height]))
    direction = np.einsum("nij,jk,hwk->nhwi", rotation, axes, looks)
    rays = np.concatenate(
        [np.broadcast_to(origin[:, None, None], direction.shape), direction], axis=-1
    )
    return (
        scene.cast_rays(open3d.core.Tensor(rays.astype(np.float32)))["t_hit"]
        .numpy()
        .astype(np.float64)
    )


def corners(box: dict[str, Any]) -> tuple[Floats, Floats]:
    centre, size = np.array(box["center"]), np.array(box["size"])
    return centre - size / 2, centre + size / 2


def measured(depth: Floats, recipe: Recipe, rng: np.random.Generator) -> Floats:
    """True depth to what the camera hands out, in millimetres."""
    truth = recipe.truth
    near = np.minimum(depth, 60.0)
    own = rng.standard_normal(near.shape)
    if recipe.is_rough:
        own = gaussian_filter(lfilter([1.0], [1.0, -0.5], own, axis=0), (0.0, 0.7, 0.7))
        own /= own.std()
        near = np.where(rng.random(near.shape) < 0.3, near, gaussian_filter(near, (0.0, 0.3, 0.4)))
    extra = truth.subpixel / (FOCAL * 0.05) * rng.standard_normal(near.shape)
    z = truth.scale * near + truth.bias + near**2 * (recipe.noise * own + extra)
    edge = np.zeros(z.shape, dtype=bool)
    edge[..., 1:] = near[..., 1:] < 0.92 * near[..., :-1]
    z = np.minimum(z, min(truth.clip, 4.0))
    for k in range(1, truth.holes + 1):
        z[..., :-k][edge[..., k:]] = 0.0
    for _ in range(truth.fill):
        hole = z[..., 1:] == 0.0
        z[..., 1:][hole] = np.where(z[..., :-1] > 0.0, z[..., :-1], 0.0)[hole]
    for k in range(1, len(z)):
        z[k] = truth.alpha * z[k] + (1.0 - truth.alpha) * z[k - 1]
    return np.rint(1e3 * np.maximum(z, 0.0)).astype(np.uint16)
