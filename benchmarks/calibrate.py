"""Exactness of `saltus render calibrate`: cameras that sit otherwise than claimed,
on robots that stand.

Each recording is of a real run in lockstep; pitch is drawn within 5 degrees, height within 3 cm,
errors are a D435i's.

    saltus bench calibrate -- --recordings 20
"""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._command import Command, progress, tell
from saltus.config import RunConfig, TerrainConfig
from saltus.effects.camera import CameraHeight, CameraPitch
from saltus.effects.profile import SHIPPED, load_profile
from saltus.render.calibrate import calibrate_camera
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.runtime.stack import Stack

PITCH, HEIGHT_M = np.deg2rad(5.0), 0.03
STANDS_S = 1.0  # before the first jump


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    recordings: int = 20
    """How many."""
    seed: int = 0
    """Seed of the first; it draws the camera's place and the trial."""

    def measure(self) -> dict[str, Any]:
        """Largest and usual errors, and how often intervals hold the truth."""
        rows = [
            self._one(seed)
            for seed in progress(range(self.seed, self.seed + self.recordings), "calibrate")
        ]
        pitch, height = np.abs(np.array([row[:2] for row in rows])).T
        inside = np.array([row[2:] for row in rows])
        return {
            "calibrate": {
                "recordings": len(rows),
                "pitch_deg_max": round(float(pitch.max()), 4),
                "pitch_deg_p50": round(float(np.median(pitch)), 4),
                "height_mm_max": round(float(height.max()), 3),
                "height_mm_p50": round(float(np.median(height)), 3),
                "within_0.3_deg_and_5_mm": int(((pitch <= 0.3) & (height <= 5.0)).sum()),
                "intervals_hold_pitch": int(inside[:, 0].sum()),
                "intervals_hold_height": int(inside[:, 1].sum()),
            }
        }

    def _one(self, seed: int) -> tuple[float, float, bool, bool]:
        """Errors of pitch [deg] and height [mm], and whether their intervals hold the truth."""
        pitch, height = np.random.default_rng([seed, 1]).uniform(-1.0, 1.0, 2) * (PITCH, HEIGHT_M)
        robot = load_robot(DEFAULT_ROBOT)
        shipped = load_profile(SHIPPED, robot)
        hidden = (CameraPitch(offset=float(pitch)), CameraHeight(offset=float(height)))
        with tempfile.TemporaryDirectory() as directory:
            folder = Path(directory)
            (folder / "hidden.toml").write_text(
                replace(shipped, camera=(*shipped.camera, *hidden)).to_toml(), encoding="utf-8"
            )
            config = RunConfig(robot="go1", grid="line",
                terrain=TerrainConfig(terrain="flat"), planner="scripted", seed=seed,
                time_limit_s=STANDS_S,
                profile=str(folder / "hidden.toml"),
            )  # fmt: skip
            with Stack(config, folder / "run") as stack:
                stack.wait()
            found = calibrate_camera(folder / "run" / "recording.mcap")
        off_pitch = found.found.pitch - (robot.camera_pitch + pitch)
        off_height = found.found.height - (robot.camera_position[2] + height)
        tell(
            f"seed {seed}: pitch off by {np.rad2deg(off_pitch):.4f} deg, height by "
            f"{1e3 * off_height:.3f} mm"
        )
        half = found.half_width_90
        return (
            float(np.rad2deg(off_pitch)),
            float(1e3 * off_height),
            abs(off_pitch) <= half.pitch,
            abs(off_height) <= half.height,
        )
