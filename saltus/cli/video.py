"""The video of a recorded run, and the picture for the documentation."""

from pathlib import Path

import numpy as np
from tqdm import tqdm

from saltus.grid import HEIGHTMAP_X
from saltus.messages import HeightmapStatus
from saltus.recording import Recording
from saltus.report import RunData, collect
from saltus.sim.video import FPS, render_run
from saltus.sim.video import write_video as encode
from saltus.terrain.terrain import Terrain


def write_video(recording: Recording, terrain: Terrain, path: Path) -> None:
    """Writes an MP4 of the robot with the predicted heightmap on the terrain, with progress on a terminal."""
    data = collect(recording)
    base_pose = np.concatenate([data.position, data.quaternion], axis=1)
    joint_position = np.array([truth.joint_position for truth in data.truths])
    frames = render_run(terrain, data.time_s, base_pose, joint_position, HEIGHTMAP_X, _heights(data))
    total = int(data.time_s[-1] * FPS) if len(data.time_s) else 0
    encode(path, tqdm(frames, total=total, desc="video", unit="frame", disable=None, leave=False))


def _heights(data: RunData) -> np.ndarray:
    """Predicted heights of every step, shape (n, 30); NaN, which is not drawn, where there is no usable prediction."""
    rows = []
    for truth in data.truths:
        heightmap = data.heightmaps.get(truth.step)
        usable = heightmap is not None and heightmap.status in (HeightmapStatus.OK, HeightmapStatus.DEGRADED)
        rows.append(heightmap.height if heightmap is not None and usable else np.full(len(HEIGHTMAP_X), np.nan))
    return np.array(rows)
