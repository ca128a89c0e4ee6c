"""`saltus replay`: runs the heightmap service on recorded depth again and reports the difference."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from saltus import go1
from saltus.cli.output import print_json
from saltus.errors import RecordingError
from saltus.wire.messages import DepthFrame, GroundTruth, Heightmap, HeightmapStatus, RobotState


@dataclass(frozen=True, kw_only=True)
class Replay:
    """Runs the heightmap service on the depth of a recording again and compares with what was recorded."""

    recording: Annotated[Path, tyro.conf.Positional]
    """A run (.mcap), or a RealSense recording (.bag), which has no robot state and needs --assume-level."""
    model: Path | None = None
    """ONNX file; the shipped model where it is not given."""
    assume_level: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Take the robot to stand still and level."""
    base_height_m: float = go1.STAND_HEIGHT
    """With --assume-level: height of the base above the ground."""
    camera_pitch_deg: float = round(float(np.degrees(go1.CAMERA_PITCH)), 1)
    """With --assume-level: how far the camera looks down."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print the result as one JSON object on the last line."""

    def run(self) -> int:
        """Prints the differences; 0 always, for a difference is a result."""
        from saltus.resources import resource

        model = self.model or resource("models/heightmap.onnx")
        table = self._bag(model) if self.recording.suffix == ".bag" else self._run(model)
        if self.json:
            print_json(table)
        else:
            for name, value in table.items():
                print(f"{name:22} {value}")
        return 0

    def _bag(self, model: Path) -> dict[str, object]:
        from saltus.heightmap.level_robot import LevelRobot
        from saltus.heightmap.service.replay import replay_frames
        from saltus.recordings.realsense import read_realsense

        frames = list(read_realsense(self.recording))
        if not self.assume_level:
            raise RecordingError(f"{self.recording} has no robot state: add --assume-level (see saltus replay --help)")
        stand_in = LevelRobot(base_height_m=self.base_height_m, camera_pitch_deg=self.camera_pitch_deg)
        heightmaps = replay_frames(model, frames, stand_in)
        return {
            "recording": str(self.recording),
            "frames": len(frames),
            "size": f"{frames[0].depth.shape[1]}x{frames[0].depth.shape[0]}" if frames else "none",
            "depth_unit_m": frames[0].depth_unit_m if frames else float("nan"),
            "invalid_fraction": float(np.mean([np.mean(frame.depth == 0) for frame in frames])),
            "heightmaps": len(heightmaps),
            "status": _statuses(heightmaps),
        }

    def _run(self, model: Path) -> dict[str, object]:
        from saltus.heightmap.level_robot import LevelRobot
        from saltus.heightmap.service.replay import replay_frames
        from saltus.recordings.recording import read_recording

        recording = read_recording(self.recording)
        arrivals, frames = [], []
        for arrival_ns, _, frame in recording.messages("camera/depth"):
            if isinstance(frame, DepthFrame):
                arrivals.append(arrival_ns)
                frames.append(frame)
        states = [state for _, _, state in recording.messages("controller/state") if isinstance(state, RobotState)]
        if not states and not self.assume_level:
            lost = f" (lost: {'; '.join(recording.lost)})" if recording.lost else ""
            raise RecordingError(f"{self.recording} has no robot state{lost}: add --assume-level")
        robot = LevelRobot(base_height_m=self.base_height_m, camera_pitch_deg=self.camera_pitch_deg)
        if self.assume_level:
            heightmaps = replay_frames(model, frames, robot)
        else:
            heightmaps = replay_frames(model, frames, states, arrivals)
        recorded = {m.step: m for _, _, m in recording.messages("heightmap/heightmap") if isinstance(m, Heightmap)}
        truths = {m.step: m.height for _, _, m in recording.messages("plant/truth") if isinstance(m, GroundTruth)}
        pairs = [] if self.assume_level else [(m, recorded[m.step]) for m in heightmaps if m.step in recorded]
        differences = [np.abs(np.asarray(new.height) - old.height) for new, old in pairs]
        return {
            "recording": str(self.recording),
            "lost": recording.lost,
            "frames": len(frames),
            "heightmaps": len(heightmaps),
            "compared": len(pairs),
            "max_difference_m": float(np.max(differences)) if differences else float("nan"),
            "mean_difference_m": float(np.mean(differences)) if differences else float("nan"),
            "status": _statuses(heightmaps),
            "status_differs": sum(new.status != old.status for new, old in pairs),
            "mae_recorded_m": _error(list(recorded.values()), truths),
            "mae_replayed_m": _error([] if self.assume_level else heightmaps, truths),
        }


def _statuses(heightmaps: list[Heightmap]) -> dict[str, int]:
    return dict(Counter(HeightmapStatus(heightmap.status).name.lower() for heightmap in heightmaps))


def _error(heightmaps: list[Heightmap], truths: dict[int, np.ndarray]) -> float:
    """Mean absolute error of the heightmaps of status OK [m]."""
    errors = [
        np.abs(np.asarray(heightmap.height) - truths[heightmap.step])
        for heightmap in heightmaps
        if heightmap.status == HeightmapStatus.OK and heightmap.step in truths
    ]
    return float(np.mean(errors)) if errors else float("nan")
