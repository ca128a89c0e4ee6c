"""Effects of a camera that a log cannot show, and why."""

import numpy as np

from saltus.arrays import Floats
from saltus.real2sim.problem.camera.counts import COPIES, FILLED, NOISE, CountRows
from saltus.real2sim.problem.camera.data import CameraData

FEWEST_FRAMES = 50  # to tell a share of lost images
STILL = 0.3  # noise units RMS that 10 ms of latency changes: below, a log of some seconds does not show 10 ms


def untestable_effects(data: CameraData, counts: CountRows, shift_10ms: Floats) -> dict[str, str]:
    """Names and reasons, with numbers; `shift_10ms` is what 10 ms of latency change in units of noise, any shape."""
    why: dict[str, str] = {}
    moved = float(np.sqrt(np.mean(shift_10ms**2))) if shift_10ms.size else 0.0
    if moved < STILL:
        reason = f"the scene hardly moves in the images: 10 ms change depth by {moved:.2f} of its noise, below {STILL}"
        why["camera_latency"] = why["temporal_smear"] = reason
    if not np.any(counts.kind == NOISE):
        reason = f"only {int(np.isfinite(data.difference).sum())} second differences of depth away from edges"
        why["depth_noise"] = reason
    if not np.any(counts.kind == COPIES):
        why["edge_holes"] = "no segment shows enough left edges of near objects in view"
        if not np.any(counts.kind == FILLED):
            why["hole_fill"] = why["edge_holes"] + ", nor enough holes or copies elsewhere"
    if len(data.frames.due_s) < FEWEST_FRAMES:
        why["frame_drop"] = f"{len(data.frames.due_s)} images, fewer than {FEWEST_FRAMES}"
    if data.clip_m is None:
        farthest = float(np.max(data.predicted[data.known], initial=0.0))
        why["range_clip"] = f"depth does not end early: a maximum beyond {farthest:.2f} m would not show"
    if not data.known.any():
        for name in ("camera_pitch", "camera_height", "camera_fov", "depth_scale", "depth_bias"):
            why[name] = "no pixel that is valid, in range and away from edges"
    return why
