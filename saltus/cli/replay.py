"""`saltus replay`: runs the heightmap service on recorded depth again and reports the difference."""

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from saltus.cli.output import JsonOption, finite, print_json
from saltus.cli.run_options import RobotOption
from saltus.cli.scan_options import ScanOptions
from saltus.errors import RecordingError
from saltus.flags import Flag, shown
from saltus.heightmap.level_robot import LevelRobot
from saltus.wire.messages import (
    DepthFrame,
    GroundTruth,
    Heightmap,
    HeightmapStatus,
    RobotState,
    points_of,
)

if TYPE_CHECKING:
    from saltus.heightmap.service.scan_fleet import ScanChoice
    from saltus.recordings.recording import Recording
    from saltus.robots.robot import Robot


@dataclass(frozen=True, kw_only=True)
class Replay(ScanOptions, RobotOption, JsonOption):
    """Runs the heightmap service on the depth of a recording again and compares with what was recorded.

    For example:
      saltus replay runs/one/recording.mcap
      saltus replay runs/one/recording.mcap --grid scan
      saltus replay desk.bag --assume-level --base-height-m 0.3
    """

    recording: Annotated[Path, tyro.conf.Positional]
    """A run (.mcap), which names its robot, or a RealSense recording (.bag, .db3), which has no robot state and needs
    --assume-level."""
    model: Annotated[Path | None, shown("PATH", "the shipped model")] = None
    """ONNX file."""
    assume_level: Flag = False
    """Take the robot to stand still and level.

    A recording that is shorter than the model's warm-up is repeated.
    """
    picture: Annotated[Path | None, shown("PATH", "none")] = None
    """With a grid: PNG of the last heights, half-widths and ages, seen from above."""
    level: Annotated[LevelRobot, tyro.conf.arg(name="")] = field(default_factory=LevelRobot)

    def run(self) -> int:
        """Prints the differences; 0 always, for a difference is a result."""
        from saltus.recordings.realsense import ENDINGS
        from saltus.resources import resource

        model = self.model or resource("models/heightmap.onnx")
        choice, bag = self.scan_choice(self.model), self.recording.suffix in ENDINGS
        if choice is None:
            table, standing = self._bag(model) if bag else self._run(model)
        else:
            table, standing = self._scan(choice), list[Heightmap]()
        if self.json:
            print_json(table)
            return 0
        for name, value in finite(table).items():
            if not isinstance(value, list) or name == "lost":
                print(f"{name:22} {'-' if value is None else value}")
        if standing:
            _print_profile(standing[-1])
        return 0

    def _scan(self, choice: "ScanChoice") -> dict[str, object]:
        """Figures of the heights of a grid: how far they are off the simulator's ground."""
        from saltus.heightmap.evaluation.scan_picture import write_picture
        from saltus.heightmap.evaluation.scan_replay import replayed_run, scan_errors, true_heights
        from saltus.recordings.recording import read_recording

        recording, statuses, last = (
            read_recording(self.recording),
            Counter[str](),
            list[Heightmap](),
        )

        def answers() -> Iterator[Heightmap]:
            for _, _, answer in replayed_run(recording, choice):
                statuses[_status(answer)] += 1
                last[:] = [answer]
                yield answer

        figures = scan_errors(recording, choice.grid, answers())
        if self.picture is not None:
            truth = next((t for t in recording.of(GroundTruth) if t.step == last[0].step), None)
            ground = None if truth is None else true_heights(recording, choice.grid, truth)
            write_picture(self.picture, last[0], ground)
        return {
            "recording": str(self.recording),
            "lost": recording.lost,
            "status": dict(statuses),
            **figures,
        }

    def _bag(self, model: Path) -> tuple[dict[str, object], list[Heightmap]]:
        from saltus.recordings.realsense import read_realsense
        from saltus.robots.loading import load_robot

        first = next(read_realsense(self.recording), None)
        if first is None:
            raise RecordingError(f"{self.recording} holds no depth image")
        if not self.assume_level:
            raise RecordingError(
                f"{self.recording} has no robot state: add --assume-level (see saltus replay "
                "--help)"
            )
        invalid: list[float] = []
        read = partial(read_realsense, self.recording)
        profile, heightmaps = self._standing(load_robot(self.robot), model, read, invalid)
        table = {
            "recording": str(self.recording),
            "frames": len(invalid),
            "size": f"{first.depth.shape[1]}x{first.depth.shape[0]}",
            "depth_unit_m": first.depth_unit_m,
            "invalid_fraction": float(np.mean(invalid)),
            **profile,
        }
        return table, heightmaps

    def _run(self, model: Path) -> tuple[dict[str, object], list[Heightmap]]:
        from saltus.heightmap.evaluation.comparison import lost_note
        from saltus.heightmap.service.network import HeightmapNetwork
        from saltus.heightmap.service.replay import replay_predictor
        from saltus.heightmap.service.service import HeightmapService
        from saltus.recordings.recording import read_recording
        from saltus.wire.topics import depth_topic

        recording = read_recording(self.recording)
        lost = lost_note(recording.lost)
        times = [
            (arrival_ns, envelope.capture_ns)
            for arrival_ns, envelope, _ in recording.payloads("camera/depth")
        ]
        if not times:
            raise RecordingError(f"{self.recording} has no depth image{lost}")
        start = {"recording": str(self.recording), "lost": recording.lost, "frames": len(times)}
        if self.assume_level:
            profile, heightmaps = self._standing(
                recording.robot, model, partial(_frames, recording), []
            )
            return {**start, **profile}, heightmaps
        states = recording.of(RobotState)
        if not states:
            raise RecordingError(f"{self.recording} has no robot state{lost}: add --assume-level")
        latency_s = 1e-9 * min(arrival_ns - capture_ns for arrival_ns, capture_ns in times)
        service = HeightmapService(HeightmapNetwork(recording.robot, model), depth_topic(latency_s))
        arrivals = (arrival_ns for arrival_ns, _ in times)
        return {
            **start,
            **_differences(
                recording, replay_predictor(service, _frames(recording), states, arrivals)
            ),
        }, []

    def _standing(
        self,
        robot: "Robot",
        model: Path,
        read: Callable[[], Iterator[DepthFrame]],
        invalid: list[float],
    ) -> tuple[dict[str, object], list[Heightmap]]:
        """How a standing robot sees the images, and the last heightmap.

        Appends each image's share without depth.
        """
        from saltus.heightmap.service.network import HeightmapNetwork
        from saltus.heightmap.service.replay import replay_standing
        from saltus.heightmap.service.stamps import SteadyStamps

        stamps, statuses, last, before = SteadyStamps(), Counter[str](), None, None
        for frame, last in replay_standing(HeightmapNetwork(robot, model), read, self.level):
            if frame.frame_id != before:  # a lockstep run may have an image twice
                stamps.step(frame.time_ns)
            before = frame.frame_id
            invalid.append(float(np.mean(frame.depth == 0)))
            statuses[_status(last)] += 1
        assert last is not None  # noqa: S101 - there is an image, or it has been said
        if stamps.count:
            print(f"saltus: {self.recording}: {stamps.note()}", file=sys.stderr)
        arrays = {
            name: np.asarray(getattr(last, name)).tolist()
            for name in ("x", "height", "half_width_90")
        }
        jumps = {"jumps": stamps.count, "largest_jump_s": stamps.largest_s}
        return {"heightmaps": statuses.total(), "status": dict(statuses), **jumps, **arrays}, [last]


def _frames(recording: "Recording") -> Iterator[DepthFrame]:
    """Its images, one after the other."""
    return (
        frame for _, _, frame in recording.messages("camera/depth") if isinstance(frame, DepthFrame)
    )


def _print_profile(heightmap: Heightmap) -> None:
    print("ahead [m]   height [m]   90 % of errors are below [m]")
    for (x, _), height, half in zip(
        points_of(heightmap), heightmap.height, heightmap.half_width_90, strict=True
    ):
        print(f"{x:9.3f}   {height:10.3f}   {half:10.3f}")


def _differences(recording: "Recording", heightmaps: list[Heightmap]) -> dict[str, object]:
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
        "status": dict(Counter(map(_status, heightmaps))),
        "status_differs": sum(new.status != old.status for new, old in pairs),
        "mae_recorded_m": _error(recorded.values(), truths),
        "mae_replayed_m": _error(heightmaps, truths),
    }


def _status(heightmap: Heightmap) -> str:
    return HeightmapStatus(heightmap.status).name.lower()


def _error(heightmaps: Iterable[Heightmap], truths: dict[int, np.ndarray]) -> float | None:
    """Mean absolute error of the heightmaps of status OK [m]; None where there are none."""
    errors = [
        np.abs(np.asarray(heightmap.height) - truths[heightmap.step])
        for heightmap in heightmaps
        if heightmap.status == HeightmapStatus.OK and heightmap.step in truths
    ]
    return float(np.mean(errors)) if errors else None
