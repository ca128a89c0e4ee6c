"""Runs of the camera: what hides in it, its noise, and what it delivers."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from benchmarks.hidden_effects import view
from benchmarks.hidden_effects.ray_kernel import FAR
from benchmarks.hidden_effects.robot import Floats
from benchmarks.hidden_effects.scene import Family, Scene, Setting, draw_sign

BASELINE_M = 0.050  # between the two imagers of a D435i
SAMPLES = 60_000
"""Pixels of a run that count in a response."""
HOLE = 10.0
"""Residual of a pixel that is valid in one of two images only, in units of sigma."""
EDGE = 0.05
"""Jump of depth between neighbours, in parts of the nearer, from which they are an edge."""

LIBRARY = {
    "camera_latency": Family(usual=0.01, largest=0.15, shape=draw_sign),
    "frame_drop": Family(
        usual=0.05, largest=0.5, shape=lambda rng: {"repeat": float(rng.uniform() < 0.5)}
    ),
    "temporal_smear": Family(usual=0.2, largest=0.92),
    "camera_pitch": Family(usual=0.003, largest=0.15, shape=draw_sign),
    "camera_height": Family(usual=0.002, largest=0.08, shape=draw_sign),
    "camera_fov": Family(usual=0.005, largest=0.2, shape=draw_sign),
    "depth_scale": Family(usual=0.002, largest=0.15, shape=draw_sign),
    "depth_bias": Family(usual=0.0015, largest=0.1, shape=draw_sign),
    "depth_noise": Family(usual=0.003, largest=0.5),
    "edge_holes": Family(usual=1.0, largest=12.0),
    "hole_fill": Family(usual=1.0, largest=12.0),
    "range_clip": Family(usual=0.01, largest=0.6),
}
OUTSIDE = {
    "lens_distortion": Family(usual=0.02, largest=0.8, shape=draw_sign),
    "rolling_shutter": Family(usual=0.01, largest=0.033),
    "depth_ripple": Family(
        usual=0.002, largest=0.05, shape=lambda rng: {"period": float(rng.uniform(0.1, 0.3))}
    ),
    "tilt_drift": Family(
        usual=0.003, largest=0.1, shape=lambda rng: {"cycles": float(rng.integers(1, 4))}
    ),
    "skewed_depth": Family(usual=0.01, largest=0.2, shape=draw_sign),
    "rolled_camera": Family(usual=0.01, largest=0.2, shape=draw_sign),
    "column_pattern": Family(usual=0.003, largest=0.05),
    "breathing_scale": Family(
        usual=0.003, largest=0.05, shape=lambda rng: {"rate": float(rng.uniform(0.3, 1.5))}
    ),
    "soft_mount": Family(usual=0.003, largest=0.05),
}
MOVES_RAYS = {
    "camera_latency", "camera_pitch", "camera_height", "camera_fov", "lens_distortion",
    "rolling_shutter", "tilt_drift",
    "rolled_camera", "soft_mount",
}  # fmt: skip
CHANGES_RANGE = {
    "depth_scale",
    "depth_bias",
    "depth_noise",
    "skewed_depth",
    "depth_ripple",
    "column_pattern",
    "breathing_scale",
}
FAMILIES = {**LIBRARY, **OUTSIDE}


@dataclass(frozen=True, kw_only=True)
class Frames:
    """Images on a grid of arrivals."""

    arrival: Floats
    capture: Floats
    depth: Floats
    """Shape (frames, height, width) [m]; what is not valid is 0."""
    kept: np.ndarray
    """Frames that arrive at all."""
    source: np.ndarray
    """Number of the exposure that a frame shows."""


class CameraScene(Scene):
    """A camera on a trunk that is moved before boxes.

    Args:
        static: The trunk stands still at several places.
        flat: There is nothing but a floor.
    """

    families = FAMILIES
    library = tuple(LIBRARY)
    outside = tuple(OUTSIDE)

    def __init__(self, seed: int, *, tuning: bool, static: bool, flat: bool) -> None:
        rng = np.random.default_rng(seed)
        self.tuning, self.seed = tuning, seed
        width = int(rng.choice([64, 80, 96]))
        height = width * 3 // 5 if width > 64 else 48
        self.optics = view.Optics(
            width=width,
            height=height,
            focal=round(width * (rng.uniform(0.75, 0.95) if flat else rng.uniform(0.5, 0.8)), 2),
            position=np.array([0.272, 0.0075, 0.092]),
            pitch=round(rng.uniform(0.75, 0.85), 3) if flat else 0.52,
            rate=float(rng.choice([30.0, 60.0])),
        )
        self.latency = float(rng.choice([0.0, 0.03, 0.05]))
        self.range_max = float(rng.choice([4.0, 5.0]))
        self.boxes = view.scenery(rng, flat=flat)
        length = float(rng.uniform(10, 14))
        self.path = view.path(rng, length_s=length, tuning=tuning, static=static)
        self.arrival = self._arrivals(rng)
        self.sigma = float(rng.uniform(1.0e-3, 2.0e-3))
        self.speckle = float(rng.uniform(0.005, 0.015))
        self._index(rng)
        self.farthest = float(self._ideal[self._ideal < self.range_max].max())

    def move(self, path: view.Path, boxes: tuple[view.Box, ...], rng: np.random.Generator) -> None:
        """Takes the same camera along another path, before other boxes."""
        self.path, self.boxes = path, boxes
        self.arrival = self._arrivals(rng)
        self._index(rng)

    def draw(self, effect: str, where: tuple[str, ...], rng: np.random.Generator) -> Setting:
        drawn = super().draw(effect, where, rng)
        return (
            replace(drawn, shape={"sign": 1.0})
            if effect == "camera_latency" and self.latency < 0.04
            else drawn
        )

    def largest(self, setting: Setting) -> float:
        if setting.effect == "camera_latency" and setting.shape["sign"] < 0:
            return self.latency
        return super().largest(setting)

    def respond(self, variants: list[tuple[Setting, ...]]) -> Floats:
        """Depth away from edges, and holes, of pixels drawn at random."""
        return np.stack([self._respond(settings) for settings in variants])

    def parameters(self, setting: Setting) -> dict[str, float | list[list[float]]]:
        """Share of frames that was lost indeed."""
        size, signed = setting.size, setting.size * setting.shape.get("sign", 1.0)
        table: dict[str, dict[str, float]] = {
            "camera_latency": {"latency": self.latency + signed},
            "frame_drop": {"fraction": float(self._lost(size, len(self.arrival)).mean())},
            "temporal_smear": {"alpha": 1.0 - size},
            "camera_pitch": {"offset": signed},
            "camera_height": {"offset": signed},
            "camera_fov": {"scale": 1.0 + signed},
            "depth_scale": {"scale": 1.0 + signed},
            "depth_bias": {"bias": signed},
            "depth_noise": {"subpixel_sigma": size},
            "edge_holes": {"width": size},
            "hole_fill": {"reach": size},
            "range_clip": {"max": self._clip(size)},
        }
        return dict(table.get(setting.effect, {"size": signed, **setting.shape}))

    def frames(self, settings: tuple[Setting, ...], rng: np.random.Generator | None) -> Frames:
        """Images as they arrive; without a generator without the noise that every run has."""
        by = {setting.effect: setting for setting in settings}
        # the same chance in every variant, whatever else is there
        chance = [np.random.default_rng(self.seed + number) for number in range(1, 4)]
        capture = self.arrival - self.latency - self._signed(by, "camera_latency")
        true = self._geometry(by, capture) if MOVES_RAYS & set(by) else self._ideal
        depth = self._range(by, true, chance[0])
        if rng is not None:
            depth = self._noise(depth, true, rng)
        valid = self._sound & (true < 0.5 * FAR)
        valid &= ~_beside_edges(true, self._size(by, "edge_holes"), chance[1])
        depth = np.where(valid, depth, np.float32(0.0))
        depth = _filled(depth, self._size(by, "hole_fill"), chance[2])
        kept, source = self._drop(by, len(capture))
        depth = depth[source]
        if "temporal_smear" in by:
            depth = _smeared(depth, 1.0 - by["temporal_smear"].size)
        depth = np.minimum(depth, np.float32(self._clip(self._size(by, "range_clip"))))
        return Frames(arrival=self.arrival, capture=capture, depth=depth, kept=kept, source=source)

    def _geometry(self, by: dict[str, Setting], capture: Floats) -> Floats:
        frames = len(capture)
        rows = np.arange(self.optics.height) / self.optics.height - 0.5
        times = capture[:, None] + self._size(by, "rolling_shutter") * rows
        offset = np.zeros((frames, 2))
        offset[:, 0] = self._signed(by, "camera_pitch")
        offset[:, 1] = self._signed(by, "camera_height")
        if "tilt_drift" in by:
            drift = by["tilt_drift"]
            offset[:, 0] += drift.size * np.sin(
                2 * np.pi * drift.shape["cycles"] * np.linspace(0, 1, frames)
            )
        offset[:, 0] += self._size(by, "soft_mount") * self.path.shake(capture)
        tangents = self.optics.tangents(
            1 + self._signed(by, "camera_fov"), self._signed(by, "lens_distortion")
        )
        tangents = view.rolled(tangents, self._signed(by, "rolled_camera"))
        return view.render(self.optics, self.boxes, self.path.at(times), tangents, offset)

    def _range(self, by: dict[str, Setting], true: Floats, chance: np.random.Generator) -> Floats:
        if not CHANGES_RANGE & set(by):
            return true
        columns = np.linspace(-1, 1, self.optics.width)
        scale = (1 + self._signed(by, "depth_scale")) * (
            1 + self._signed(by, "skewed_depth") * columns
        )
        depth = true * scale.astype(np.float32) + np.float32(self._signed(by, "depth_bias"))
        if "depth_ripple" in by:
            ripple = by["depth_ripple"]
            depth = depth + np.float32(ripple.size) * np.sin(
                np.float32(2 * np.pi / ripple.shape["period"]) * true
            )
        if "column_pattern" in by:
            pattern = np.random.default_rng(self.seed).normal(size=self.optics.width)
            depth = depth * (1 + by["column_pattern"].size * pattern).astype(np.float32)
        if "breathing_scale" in by:
            breath = by["breathing_scale"]
            wave = breath.size * np.sin(2 * np.pi * breath.shape["rate"] * self.arrival)
            depth = depth * (1 + wave).astype(np.float32)[:, None, None]
        if "depth_noise" not in by:
            return np.asarray(depth)
        # matching errs in blocks: neighbours share a part of the error
        white = chance.standard_normal(true.shape, dtype=np.float32)
        shared = white + uniform_filter1d(white, 3, axis=2)
        shared /= np.sqrt(1 + 1 / 3 + 2 / 3)
        sigma = np.minimum(true, 50.0) ** 2 * np.float32(
            by["depth_noise"].size / (self.optics.focal * BASELINE_M)
        )
        return np.asarray(depth + sigma * shared)

    def _noise(self, depth: Floats, true: Floats, rng: np.random.Generator) -> Floats:
        """Noise that hardly depends on range, and pixels at edges that see both sides."""
        pole = 0.2 if self.tuning else 0.45
        white = rng.standard_normal((len(depth) + 8, *depth.shape[1:]), dtype=np.float32)
        gain = np.array([np.sqrt(1 - pole**2)], dtype=np.float32)
        noise = lfilter(gain, np.array([1.0, -pole], dtype=np.float32), white, axis=0)[8:]
        noisy = depth + np.float32(self.sigma) * noise
        left = np.concatenate([noisy[:, :, :1], noisy[:, :, :-1]], axis=2)
        mixed = _edges(true) & (rng.random(depth.shape, dtype=np.float32) < 0.3)
        part = rng.random(depth.shape, dtype=np.float32)
        return np.where(mixed, part * noisy + (1 - part) * left, noisy)

    def _lost(self, fraction: float, count: int) -> np.ndarray:
        """Images that never come: the same ones whatever else is there."""
        lost = np.random.default_rng(self.seed + 4).uniform(size=count) < fraction
        lost[0] = False
        return np.asarray(lost)

    def _drop(self, by: dict[str, Setting], count: int) -> tuple[np.ndarray, np.ndarray]:
        lost = self._lost(self._size(by, "frame_drop"), count)
        source = np.maximum.accumulate(np.where(lost, 0, np.arange(count)))
        repeats = "frame_drop" in by and by["frame_drop"].shape["repeat"] > 0
        return (np.ones(count, dtype=bool) if repeats else ~lost), source

    def _respond(self, settings: tuple[Setting, ...]) -> Floats:
        depth = self.frames(settings, None).depth.reshape(-1)[self._picked]
        seen = np.where(depth > 0, depth, self._reference)
        return np.concatenate([self._weight * seen / self.sigma, HOLE * (depth > 0)])

    def _arrivals(self, rng: np.random.Generator) -> Floats:
        # long enough before the first image for the oldest exposure
        exact = np.arange(0.3, self.path.segments[-1].end_s, 1 / self.optics.rate)
        return np.asarray(exact + rng.normal(0, 2e-4, len(exact)))

    def _index(self, rng: np.random.Generator) -> None:
        truth = self._geometry({}, self.arrival - self.latency)
        self._ideal = truth
        self._sound = (
            np.random.default_rng(self.seed).random(truth.shape, dtype=np.float32) >= self.speckle
        )
        near_edge = _edges(truth) | np.roll(_edges(truth), -1, axis=2)
        near_edge |= np.abs(np.diff(truth, axis=1, prepend=truth[:, :1])) > EDGE * truth
        for axis in (1, 2):
            near_edge = near_edge | np.roll(near_edge, 1, axis) | np.roll(near_edge, -1, axis)
        self._picked = np.sort(rng.permutation(truth.size)[:SAMPLES])
        self._reference = truth.reshape(-1)[self._picked]
        self._weight = ~near_edge.reshape(-1)[self._picked] & (self._reference < self.range_max)
        self._reference = np.minimum(self._reference, self.range_max)
        starts = np.array([segment.start_s for segment in self.path.segments])
        frame = self._picked // (self.optics.height * self.optics.width)
        segment = np.searchsorted(starts, self.arrival[frame], side="right") - 1
        self.group = np.concatenate([2 * segment, 2 * segment + 1])
        self.nuisances = np.zeros((0, len(self.group)))
        self.places = np.full(len(self.group), "camera")

    def _clip(self, size: float) -> float:
        return self.range_max if size == 0 else self.farthest * (1 - size)

    @staticmethod
    def _size(by: dict[str, Setting], effect: str) -> float:
        return by[effect].size if effect in by else 0.0

    @staticmethod
    def _signed(by: dict[str, Setting], effect: str) -> float:
        return by[effect].size * by[effect].shape.get("sign", 1.0) if effect in by else 0.0


def _edges(true: Floats) -> np.ndarray:
    """Pixels at whose left the background begins."""
    left = np.concatenate([true[:, :, :1], true[:, :, :-1]], axis=2)
    return np.asarray(left - true > EDGE * true)


def _beside_edges(true: Floats, width: float, rng: np.random.Generator) -> np.ndarray:
    """Pixels at the left of foreground edges that one imager cannot see."""
    out = np.zeros(true.shape, dtype=bool)
    if width <= 0:
        return out
    edges = _edges(true)
    whole = int(width)
    part = rng.random(true.shape, dtype=np.float32) < width - whole
    for shift in range(1, whole + 2):
        reaches = edges if shift <= whole else edges & part
        out[:, :, :-shift] |= reaches[:, :, shift:]
    return out


def _filled(depth: Floats, reach: float, rng: np.random.Generator) -> Floats:
    """Invalid pixels take the value of the nearest valid one at their left,
    if that is near enough.
    """
    if reach <= 0:
        return depth
    column = np.arange(depth.shape[2])
    last = np.maximum.accumulate(np.where(depth > 0, column, -1), axis=2)
    allowed = np.floor(reach) + (rng.random(depth.shape, dtype=np.float32) < reach % 1)
    near = (depth == 0) & (last >= 0) & (column - last <= allowed)
    return np.where(near, np.take_along_axis(depth, np.maximum(last, 0), axis=2), depth)


def _smeared(depth: Floats, alpha: float) -> Floats:
    out = depth.copy()
    for k in range(1, len(out)):
        both = (out[k - 1] > 0) & (depth[k] > 0)
        out[k] = np.where(
            both, np.float32(alpha) * depth[k] + np.float32(1 - alpha) * out[k - 1], depth[k]
        )
    return out
