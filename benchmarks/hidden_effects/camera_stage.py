"""Runs of the camera: surroundings that fit the effects, and files."""

import numpy as np

from benchmarks.hidden_effects import experiments
from benchmarks.hidden_effects.camera import CameraScene
from benchmarks.hidden_effects.plan import Run
from benchmarks.hidden_effects.robot import JOINTS, STAND, Floats
from benchmarks.hidden_effects.scene import Setting
from benchmarks.hidden_effects.stage import Stage
from benchmarks.hidden_effects.tables import BASE, RunFiles, claim
from benchmarks.hidden_effects.view import Path

IN_TIME = {
    "camera_latency",
    "frame_drop",
    "temporal_smear",
    "rolling_shutter",
    "tilt_drift",
    "soft_mount",
}
"""Effects that need motion."""
AT_EDGES = {"edge_holes", "hole_fill", "range_clip", "lens_distortion", "depth_ripple"}
"""Effects that need something to look at besides a floor."""


class CameraStage(Stage):
    place = ("camera",)

    def __init__(self, run: Run, tuning: bool) -> None:
        rng = np.random.default_rng(run.seed + 1)
        static = rng.uniform() < 0.25 and not IN_TIME & set(run.effects)
        flat = rng.uniform() < 0.25 and not AT_EDGES & set(run.effects)
        self._camera = CameraScene(run.seed, tuning=tuning, static=static, flat=flat)
        self.scene = self._camera
        self.sizing = self._camera
        self._tells_capture = rng.uniform() < 0.5

    def follow(self, experiment: str, rng: np.random.Generator) -> bool:
        if experiment not in experiments.CAMERA:
            return False
        path, boxes = experiments.camera_path(experiment)
        self._camera.move(path, boxes, rng)
        return True

    def record(self, settings: tuple[Setting, ...], rng: np.random.Generator) -> RunFiles:
        scene, start = self._camera, float(rng.uniform(0, 1000))
        path = scene.path
        t = np.arange(0, path.segments[-1].end_s, 0.01)
        joints: dict[str, Floats] = {"t": t + start}
        for number, joint in enumerate(JOINTS):
            joints[f"q_{joint}"] = STAND[number] + rng.normal(0, 3e-4, len(t))
        for number, joint in enumerate(JOINTS):
            joints[f"q_des_{joint}"] = np.full(len(t), STAND[number])
        kp, kd = np.full(12, 100.0), np.full(12, 2.0)
        meta = claim(
            base="free", kp=kp, kd=kd, control_dt=0.01, segments=path.segments, start_s=start
        )
        if scene.boxes:
            meta["terrain"] = [
                {"center": list(box.center), "size": list(box.size)} for box in scene.boxes
            ]
        optics = scene.optics
        meta["camera"] = {
            "fx": optics.focal,
            "fy": optics.focal,
            "cx": optics.width / 2,
            "cy": optics.height / 2,
            "width": optics.width,
            "height": optics.height,
            "position": optics.position.tolist(),
            "pitch": optics.pitch,
            "rate": optics.rate,
            "latency": scene.latency,
            "range_max": scene.range_max,
        }
        return RunFiles(
            meta=meta,
            tables={"joints": joints, "base": _base(path, start, rng)},
            depth=self._depth(settings, start, rng),
        )

    def _depth(
        self, settings: tuple[Setting, ...], start: float, rng: np.random.Generator
    ) -> dict[str, np.ndarray]:
        frames = self._camera.frames(settings, rng)
        kept = frames.kept
        number = frames.source if kept.all() else np.arange(len(kept))
        depth = {
            "t_arrival": frames.arrival[kept] + start,
            "frame_id": (number[kept] + int(rng.integers(1, 5000))).astype(np.int64),
            "depth": np.clip(np.rint(1e3 * frames.depth[kept]), 0, 65535).astype(np.uint16),
        }
        if self._tells_capture:
            depth["t_capture"] = frames.capture[frames.source][kept] + start
        return depth


def _base(path: Path, start: float, rng: np.random.Generator) -> dict[str, Floats]:
    """Motion capture at 200 Hz."""
    t = np.arange(0, path.segments[-1].end_s, 0.005)
    x, z, pitch = path.at(t)
    pitch = pitch + rng.normal(0, 4e-4, len(t))
    zero = np.zeros_like(t)
    columns = [
        x,
        zero,
        z,
        np.cos(pitch / 2),
        zero,
        np.sin(pitch / 2),
        zero,
        np.gradient(x, t),
        zero,
        np.gradient(z, t),
    ]
    noise = [3e-4, 3e-4, 3e-4, 0.0, 2e-4, 0.0, 2e-4, 0.005, 0.005, 0.005]
    table: dict[str, Floats] = {"t": t + start}
    for name, values, sigma in zip(BASE, columns, noise, strict=True):
        table[name] = values + sigma * rng.normal(size=len(t))
    return table
