"""The video of a recorded run, and the picture for the documentation."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from saltus.recordings.recording import Recording
from saltus.recordings.report import RunData, join_by_step
from saltus.sim.video import FPS, render_run
from saltus.sim.video import write_video as encode
from saltus.watch.pictures import BESIDE, video_panel
from saltus.watch.source import RecordedRun
from saltus.wire.messages import HeightmapStatus

SIZE = (1280, 720)
ROBOT = (SIZE[0] - BESIDE[0], SIZE[1])
"""Width and height of a video, and of the robot in it [px]."""
PICTURE_AT = (0.42, 0.56, 0.70)
"""Shares of the run: after the start, before the end."""


def write_run_video(recording: Recording, path: Path) -> None:
    """Writes an MP4 of the robot with the predicted heightmap on the terrain,
    with progress on a terminal.

    Beside the robot stand time and speed, the newest depth image, and the heights with their
    intervals and the truth.

    A picture goes with it, with the suffix .png: three moments of the run side by side.
    """
    from tqdm import tqdm

    data = join_by_step(recording)
    run = RecordedRun(recording)
    base_pose = np.concatenate([data.position, data.quaternion], axis=1)
    joint_position = np.array([truth.joint_position for truth in data.truths])
    frames = render_run(
        recording.robot,
        recording.terrain,
        data.time_s,
        base_pose,
        joint_position,
        recording.grid,
        _heights(data, recording.grid.size),
        size=ROBOT,
    )
    total = int(data.time_s[-1] * FPS) if len(data.time_s) else 0
    moments: list[np.ndarray] = []
    kept = _keep(frames, [int(share * total) for share in PICTURE_AT], moments)
    shown = (
        np.hstack(
            [
                frame,
                video_panel(
                    run.world,
                    run.at_ns(data.start_ns + round(1e9 * (data.time_s[0] + number / FPS))),
                ),
            ]
        )
        for number, frame in enumerate(kept)
    )
    encode(
        path,
        tqdm(shown, total=total, desc="video", unit="frame", disable=None, leave=False),
        size=SIZE,
    )
    if moments:
        cv2.imwrite(
            str(path.with_suffix(".png")), cv2.cvtColor(np.hstack(moments), cv2.COLOR_RGB2BGR)
        )


def _keep(
    frames: Iterator[np.ndarray], numbers: list[int], kept: list[np.ndarray]
) -> Iterator[np.ndarray]:
    """Passes frames on and appends those with the given numbers to `kept`."""
    for number, frame in enumerate(frames):
        if number in numbers:
            kept.append(frame.copy())
        yield frame


def _heights(data: RunData, size: int) -> np.ndarray:
    """Predicted heights of every step, shape (n, size);
    NaN, which is not drawn, where there is no usable prediction.
    """
    rows = []
    for truth in data.truths:
        heightmap = data.heightmaps.get(truth.step)
        usable = heightmap is not None and heightmap.status in (
            HeightmapStatus.OK,
            HeightmapStatus.DEGRADED,
        )
        rows.append(heightmap.height if heightmap is not None and usable else np.full(size, np.nan))
    return np.array(rows)
