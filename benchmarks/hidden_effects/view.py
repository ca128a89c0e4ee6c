"""Scenes of the camera, and how its carrier moves:
boxes, motions of the trunk, and the rays between them.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp
from scipy.ndimage import gaussian_filter1d

from benchmarks.hidden_effects import ray_kernel
from benchmarks.hidden_effects.motions import Segment
from benchmarks.hidden_effects.robot import STAND_HEIGHT, Floats

REST_S = 0.4


@dataclass(frozen=True, kw_only=True)
class Box:
    """A box in the world."""

    center: tuple[float, float, float]
    size: tuple[float, float, float]
    """Full edge lengths [m]."""


@dataclass(frozen=True, kw_only=True)
class Path:
    """Motion of the trunk in its plane of symmetry, on a fine grid of times."""

    time_s: Floats
    x: Floats
    z: Floats
    pitch: Floats
    """Nose down positive [rad]."""
    segments: tuple[Segment, ...]

    def at(self, time_s: Floats) -> tuple[Floats, Floats, Floats]:
        """x, z and pitch at other times."""
        return tuple(
            np.interp(time_s, self.time_s, values) for values in (self.x, self.z, self.pitch)
        )  # type: ignore[return-value]

    def shake(self, time_s: Floats) -> Floats:
        """Vertical acceleration and that of pitch,
        smoothed over 25 ms, in parts of their largest.
        """
        step = self.time_s[1] - self.time_s[0]
        total = np.zeros_like(self.time_s)
        for values in (self.z, self.pitch):
            smooth = gaussian_filter1d(values, 0.025 / step)
            total += np.gradient(np.gradient(smooth, step), step) / 10.0
        return np.asarray(np.interp(time_s, self.time_s, total / max(np.abs(total).max(), 1e-9)))


@dataclass(frozen=True, kw_only=True)
class Optics:
    """A camera on the trunk."""

    width: int
    height: int
    focal: float
    """Focal length [px], the same in both directions.

    The optical axis goes through the image's middle.
    """
    position: Floats
    pitch: float
    rate: float

    def tangents(self, scale: float = 1.0, distortion: float = 0.0) -> Floats:
        """Tangents of the viewing angles of all pixels to the right and down,
        shape (height, width, 2).
        """
        u = (np.arange(self.width) + 0.5 - 0.5 * self.width) / self.focal
        v = (np.arange(self.height) + 0.5 - 0.5 * self.height) / self.focal
        both = np.stack(np.meshgrid(u, v), axis=-1)
        return np.asarray(scale * both * (1 + distortion * (both**2).sum(axis=-1, keepdims=True)))


def rolled(tangents: Floats, angle: float) -> Floats:
    """Tangents of a camera that is turned about its optical axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(tangents @ np.array([[c, s], [-s, c]]))


def scenery(rng: np.random.Generator, *, flat: bool) -> tuple[Box, ...]:
    """A wall and some things before it, or nothing."""
    if flat:
        return ()
    wall = rng.uniform(1.7, 2.4)
    boxes = [Box(center=(round(wall + 0.25, 3), 0.0, 1.5), size=(0.5, 8.0, 3.0))]
    near, height = rng.uniform(0.75, 1.0), rng.uniform(0.08, 0.2)
    boxes.append(
        Box(
            center=(round(near + 0.2, 3), round(rng.uniform(-0.4, -0.1), 3), height / 2),
            size=(0.4, 0.5, height),
        )
    )
    height = rng.uniform(0.25, 0.6)
    boxes.append(
        Box(
            center=(round(rng.uniform(1.2, 1.5), 3), round(rng.uniform(0.2, 0.5), 3), height / 2),
            size=(0.2, 0.25, height),
        )
    )
    return tuple(boxes)


def path(rng: np.random.Generator, *, length_s: float, tuning: bool, static: bool) -> Path:
    """Segments of the trunk's motion, each with a repeat."""
    if static:
        names = ["near", "far", "low"]
    else:
        names = ["heave", "rock", "near"] if tuning else ["bob", "nod", "hops", "far"]
        if rng.uniform() < 0.5:
            names.append("lifts" if tuning else "surge")
    order = [(name, number) for name in names for number in range(2)]
    rng.shuffle(order)
    seeds = {name: int(rng.integers(2**31)) for name in names}
    each = length_s / len(order)
    t = np.arange(0, length_s + 0.5, 1e-3)
    values = np.zeros((3, len(t)))
    segments = []
    for place, (name, number) in enumerate(order):
        start = place * each
        inside = (t >= start) & (t < start + each)
        values[:, inside] = _move(name, t[inside] - start, each, np.random.default_rng(seeds[name]))
        segments.append(
            Segment(name=f"{name}-{number}", start_s=start, end_s=start + each, condition=name)
        )
    return path_of(t, values, tuple(segments))


def path_of(time_s: Floats, offsets: Floats, segments: tuple[Segment, ...]) -> Path:
    """Path of a trunk that is moved by `offsets` of x,
    z and pitch, shape (3, n), from where it stands.
    """
    return Path(
        time_s=time_s,
        x=offsets[0],
        z=STAND_HEIGHT + offsets[1],
        pitch=offsets[2],
        segments=segments,
    )


def _move(name: str, t: Floats, length: float, rng: np.random.Generator) -> Floats:
    """Offsets of x, z and pitch in a segment, shape (3, n)."""
    ease = np.clip(np.minimum(t, length - t) / REST_S, 0, 1)
    ease = ease * ease * (3 - 2 * ease)
    zero = np.zeros_like(t)
    top = rng.uniform(2.2, 3.2)
    sweep = np.sin(2 * np.pi * (0.4 * t + 0.5 * (top - 0.4) * t**2 / length))
    mixed = (
        sum(
            np.sin(2 * np.pi * f * t + p)
            for f, p in zip(rng.uniform(0.4, 3, 4), rng.uniform(0, 6.28, 4), strict=True)
        )
        / 2.5
    )
    slots = np.cumsum(rng.uniform(0.25, 0.5, 40))
    levels = np.interp(
        t, np.stack([slots, slots + 0.08], 1).ravel(), np.repeat(rng.uniform(-1, 1, 41), 2)[1:-1]
    )
    moves = {
        "heave": (zero, 0.03 * sweep, zero),
        "rock": (zero, zero, 0.09 * sweep),
        "bob": (zero, 0.03 * mixed, 0.02 * mixed),
        "nod": (zero, 0.008 * mixed, 0.08 * mixed),
        "hops": (zero, 0.035 * levels, zero),
        "lifts": (zero, 0.03 * levels, 0.03 * levels),
        "surge": (0.12 * sweep, zero, zero),
        "near": (0.15 + zero, zero, zero),
        "far": (-0.15 + zero, zero, zero),
        "low": (zero, -0.05 + zero, 0.05 + zero),
    }
    return np.asarray(ease * np.stack(moves[name]))


def render(
    optics: Optics,
    boxes: tuple[Box, ...],
    poses: tuple[Floats, Floats, Floats],
    tangents: Floats,
    offset: Floats,
) -> Floats:
    """Depth images without noise, shape (frames, height, width) [m].

    Args:
        optics: The camera.
        boxes: What stands on the floor.
        poses: x, z and pitch of the trunk, each of shape (frames,) or (frames, height): one for
            each row of pixels.
        tangents: Of the pixels' viewing angles.
        offset: Added to the camera's pitch, shape (frames,), and height [rad, m]; shape (frames,
            2).
    """
    x, z, pitch = (
        np.broadcast_to(np.reshape(p, (len(p), -1)), (len(p), optics.height)) for p in poses
    )
    mounted = pitch + optics.pitch + offset[:, :1]
    shift = (
        np.broadcast_to(optics.position, (*x.shape, 3))
        + np.array([0.0, 0.0, 1.0]) * offset[:, 1, None, None]
    )
    trunk, camera = _nose_down(pitch), _nose_down(mounted)
    origin = np.einsum("frij,frj->fri", trunk, shift) + np.stack([x, np.zeros_like(x), z], axis=-1)
    depth = wp.zeros((len(x), optics.height, optics.width), dtype=float, device="cpu")
    ends = [
        (np.array(b.center) - np.array(b.size) / 2, np.array(b.center) + np.array(b.size) / 2)
        for b in boxes
    ]
    low, high = (np.array([e[i] for e in ends], dtype=np.float32).reshape(-1, 3) for i in (0, 1))
    arrays = [
        wp.array(origin.astype(np.float32), dtype=wp.vec3, device="cpu"),
        wp.array(camera.astype(np.float32), dtype=wp.mat33, device="cpu"),
        wp.array(tangents.astype(np.float32), dtype=wp.vec2, device="cpu"),
        wp.array(low, dtype=wp.vec3, device="cpu"),
        wp.array(high, dtype=wp.vec3, device="cpu"),
    ]
    wp.launch(ray_kernel.cast, dim=depth.shape, inputs=arrays, outputs=[depth], device="cpu")
    return np.asarray(depth.numpy())


def _nose_down(angle: Floats) -> Floats:
    """Rotations about y that turn x towards -z, shape (..., 3, 3)."""
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    rows = ((c, zero, s), (zero, one, zero), (-s, zero, c))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
