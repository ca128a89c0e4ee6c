"""`saltus replay`: runs the heightmap service on recorded depth again and reports the difference."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from saltus.cli.output import finite, print_json
from saltus.config import DEFAULT_ROBOT
from saltus.errors import RecordingError
from saltus.flags import Flag, shown
from saltus.heightmap.level_robot import LevelRobot
from saltus.wire.messages import DepthFrame, GroundTruth, Heightmap, HeightmapStatus, RobotState

if TYPE_CHECKING:
    from saltus.recordings.recording import Recording
    from saltus.robots.robot import Robot


@dataclass(frozen=True, kw_only=True)
class Replay:
    """Runs the heightmap service on the depth of a recording again and compares with what was recorded.

    For example:
      saltus replay runs/one/recording.mcap
      saltus replay desk.bag --assume-level --base-height-m 0.3
    """

    recording: Annotated[Path, tyro.conf.Positional]
    """A run (.mcap), or a RealSense recording (.bag), which has no robot state and needs --assume-level."""
    model: Annotated[Path | None, shown("PATH", "the shipped model")] = None
    """ONNX file."""
    assume_level: Flag = False
    """Take the robot to stand still and level. A recording that is shorter than the model's warm-up is repeated."""
    level: Annotated[LevelRobot, tyro.conf.arg(name="")] = field(default_factory=LevelRobot)
    json: Flag = False
    """Print the result as one JSON object on the last line."""

    def run(self) -> int:
        """Prints the differences; 0 always, for a difference is a result."""
        from saltus.resources import resource

        model = self.model or resource("models/heightmap.onnx")
        bag = self.recording.suffix == ".bag"
        table, standing = self._bag(model) if bag else self._run(model)
        if self.json:
            print_json(table)
            return 0
        for name, value in finite(table).items():
            if not isinstance(value, list) or name == "lost":
                print(f"{name:22} {'-' if value is None else value}")
        if standing:
            _print_profile(standing[-1])
        return 0

    def _bag(self, model: Path) -> tuple[dict[str, Any], list[Heightmap]]:
        from saltus.recordings.realsense import read_realsense
        from saltus.robots.loading import load_robot

        frames = list(read_realsense(self.recording))
        if not frames:
            raise RecordingError(f"{self.recording} holds no depth image")
        if not self.assume_level:
            raise RecordingError(f"{self.recording} has no robot state: add --assume-level (see saltus replay --help)")
        heightmaps = self._standing(load_robot(DEFAULT_ROBOT), model, frames)
        table = {
            "recording": str(self.recording),
            "frames": len(frames),
            "size": f"{frames[0].depth.shape[1]}x{frames[0].depth.shape[0]}",
            "depth_unit_m": frames[0].depth_unit_m,
            "invalid_fraction": float(np.mean([np.mean(frame.depth == 0) for frame in frames])),
            **_profile(heightmaps),
        }
        return table, heightmaps

    def _run(self, model: Path) -> tuple[dict[str, Any], list[Heightmap]]:
        from saltus.heightmap.evaluation.comparison import lost_note
        from saltus.heightmap.service.network import HeightmapNetwork
        from saltus.heightmap.service.replay import replay_frames
        from saltus.recordings.recording import read_recording

        recording = read_recording(self.recording)
        lost = lost_note(recording.lost)
        arrivals, frames = _frames(recording)
        if not frames:
            raise RecordingError(f"{self.recording} has no depth image{lost}")
        start = {"recording": str(self.recording), "lost": recording.lost, "frames": len(frames)}
        if self.assume_level:
            heightmaps = self._standing(recording.robot, model, frames)
            return {**start, **_profile(heightmaps)}, heightmaps
        states = recording.of(RobotState)
        if not states:
            raise RecordingError(f"{self.recording} has no robot state{lost}: add --assume-level")
        heightmaps = replay_frames(HeightmapNetwork(recording.robot, model), frames, states, arrivals)
        return {**start, **_differences(recording, heightmaps)}, []

    def _standing(self, robot: "Robot", model: Path, frames: list[DepthFrame]) -> list[Heightmap]:
        from saltus.heightmap.service.network import HeightmapNetwork
        from saltus.heightmap.service.replay import replay_standing

        return replay_standing(HeightmapNetwork(robot, model), frames, self.level)


def _frames(recording: "Recording") -> tuple[list[int], list[DepthFrame]]:
    """Arrival of each image in the run's clock [ns], and the images."""
    found = [(ns, frame) for ns, _, frame in recording.messages("camera/depth") if isinstance(frame, DepthFrame)]
    return [ns for ns, _ in found], [frame for _, frame in found]


def _profile(heightmaps: list[Heightmap]) -> dict[str, Any]:
    """How many there are, and the last one."""
    last = heightmaps[-1]
    arrays = {name: np.asarray(getattr(last, name)).tolist() for name in ("x", "height", "half_width_90")}
    return {"heightmaps": len(heightmaps), "status": _statuses(heightmaps), **arrays}


def _print_profile(heightmap: Heightmap) -> None:
    print("ahead [m]   height [m]   90 % of errors are below [m]")
    for x, height, half in zip(heightmap.x, heightmap.height, heightmap.half_width_90, strict=True):
        print(f"{x:9.3f}   {height:10.3f}   {half:10.3f}")


def _differences(recording: "Recording", heightmaps: list[Heightmap]) -> dict[str, Any]:
    """Replayed heightmaps beside the recorded ones, and both beside the truth."""
    recorded = {m.step: m for m in recording.of(Heightmap)}
    truths = {m.step: m.height for m in recording.of(GroundTruth)}
    pairs = [(m, recorded[m.step]) for m in heightmaps if m.step in recorded]
    differences = [np.abs(np.asarray(new.height) - old.height) for new, old in pairs]
    return {
        "heightmaps": len(heightmaps),
        "compared": len(pairs),
        "max_difference_m": float(np.max(differences)) if differences else None,
        "mean_difference_m": float(np.mean(differences)) if differences else None,
        "status": _statuses(heightmaps),
        "status_differs": sum(new.status != old.status for new, old in pairs),
        "mae_recorded_m": _error(recorded.values(), truths),
        "mae_replayed_m": _error(heightmaps, truths),
    }


def _statuses(heightmaps: list[Heightmap]) -> dict[str, int]:
    return dict(Counter(HeightmapStatus(heightmap.status).name.lower() for heightmap in heightmaps))


def _error(heightmaps: Iterable[Heightmap], truths: dict[int, np.ndarray]) -> float | None:
    """Mean absolute error of the heightmaps of status OK [m]; None where there are none."""
    errors = [
        np.abs(np.asarray(heightmap.height) - truths[heightmap.step])
        for heightmap in heightmaps
        if heightmap.status == HeightmapStatus.OK and heightmap.step in truths
    ]
    return float(np.mean(errors)) if errors else None
