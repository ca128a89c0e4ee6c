"""`saltus replay`: runs a process on a recorded run again and compares what it says."""

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro

from saltus.cli.output import Bar, JsonOption, print_figures, print_json, without_infinities
from saltus.cli.run_options import RobotOption
from saltus.cli.scan_options import ScanOptions
from saltus.errors import ConfigError, RecordingError
from saltus.flags import Flag, flag_help
from saltus.heightmap.level_robot import LevelRobot
from saltus.wire.messages import (
    DepthFrame,
    Event,
    GroundTruth,
    Heightmap,
    HeightmapStatus,
    RobotState,
    points_of,
)

if TYPE_CHECKING:
    from saltus.config import RunConfig
    from saltus.heightmap.service.scan_fleet import ScanChoice
    from saltus.recordings.answers import AnswerComparison
    from saltus.recordings.recording import RecordedMessage, Recording
    from saltus.robots.robot import Robot
    from saltus.runtime.replay import ReplayedMessage

ProcessName = Literal["camera", "heightmap", "planner", "controller"]
PROGRAM: dict[ProcessName, str] = {
    "camera": "render",
    "heightmap": "heightmap",
    "planner": "policy",
    "controller": "controller",
}
"""Name of each process in the table of programs, where it stands for the folder of its code."""


@dataclass(frozen=True, kw_only=True)
class Replay(ScanOptions, RobotOption, JsonOption):
    """Runs a process on a recorded run again and compares what it says with what it said.

    It is fed what it heard. Of a lockstep run all must be equal to the bit: the exit code is 1
    where it is not. Of a real-time run, and with another model, a difference is a result.

    For example:
      saltus replay runs/one/recording.mcap
      saltus replay runs/one/recording.mcap --process controller
      saltus replay runs/one/recording.mcap --process planner --model runs/policy/policy.onnx
      saltus replay runs/one/recording.mcap --grid scan
      saltus replay desk.bag --assume-level --base-height-m 0.3
    """

    recording: Annotated[Path, tyro.conf.Positional]
    """A run (.mcap), which names its robot, or a RealSense recording (.bag, .db3),
    which has no robot state and needs --assume-level."""
    process: ProcessName = "heightmap"
    """Which one to run. A controller's run must have been in lockstep."""
    model: Annotated[Path | None, flag_help("PATH", "that of the run")] = None
    """ONNX file of the heightmap or of the planner, in place of the run's."""
    assume_level: Flag = False
    """Take the robot to stand still and level.

    A recording that is shorter than the model's warm-up is repeated.
    """
    picture: Annotated[Path | None, flag_help("PATH", "none")] = None
    """With a grid: PNG of heights, half-widths and ages where the ground is the most uneven, from
    above."""
    level: Annotated[LevelRobot, tyro.conf.arg(name="")] = field(default_factory=LevelRobot)

    def run(self) -> int:
        """Prints what is equal and what differs; 1 where a lockstep run does not repeat, else 0."""
        from saltus.recordings.realsense import ENDINGS
        from saltus.recordings.recording import read_recording

        self._check_flags()
        bag = self.recording.suffix in ENDINGS
        if bag or self.assume_level:
            self.scan_choice(self.model)
        if bag:
            return self._tell_profile(*self._bag())
        recording = read_recording(self.recording)
        if self.assume_level:
            return self._tell_profile(*self._level(recording))
        return self._process(recording)

    def _check_flags(self) -> None:
        """`ConfigError` for flags that say nothing to the process."""
        if self.process != "heightmap":
            given = [f"--{f}" for f in ("grid", "dialect", "picture") if getattr(self, f)]
            given += ["--cameras"] if self.cameras else []
            given += ["--assume-level"] if self.assume_level else []
            if given:
                raise ConfigError(f"{given[0]} is of the heightmap: leave --process out")
        if self.model is not None and self.process not in ("heightmap", "planner"):
            raise ConfigError(
                f"--model {self.model}: the {self.process} has no network, heightmap and planner "
                "have one"
            )

    def _process(self, recording: "Recording") -> int:
        from saltus.recordings.answers import AnswerComparison
        from saltus.runtime.replay import body_of, replay_process

        name, config, body = PROGRAM[self.process], self._config(recording), None
        choice: ScanChoice | None = None
        if self.process == "heightmap":
            grid = self.grid or recording.known_config.grid
            choice = replace(self, grid=grid).scan_choice(self.model)
            body = partial(body_of(name), scan=choice)
            if not recording.of(RobotState):
                raise RecordingError(f"{self.recording} has no robot state: add --assume-level")
        comparison, heightmaps = AnswerComparison(recording, name), list[Heightmap]()
        # On the points of the run, where anybody answered in it
        own_points = self.grid is None and bool(comparison.topics)

        def said(answer: "ReplayedMessage") -> None:
            if own_points:
                comparison.take(*answer)
            if isinstance(answer.message, Heightmap):
                heightmaps.append(answer.message)

        with Bar() as bar:
            heard = partial(_show, bar, f"replay {self.process}", max(1, recording.span_ns[1]))
            replay_process(name, recording, said, heard=heard, body=body, config=config)
        start = {
            "recording": str(self.recording),
            "process": self.process,
            "lost": recording.lost,
            **(self._figures(recording, heightmaps, choice) if heightmaps else {}),
        }
        if not own_points:
            return self._tell(start)
        comparison.finish()
        self._tell({**start, **_compared(comparison)})
        return 1 if comparison.first and _must_repeat(recording, config) else 0

    def _config(self, recording: "Recording") -> "RunConfig":
        """The configuration of the run, with the model that was asked for."""
        config = recording.known_config
        if self.model is None or self.grid is not None:
            return config
        if self.process == "heightmap":
            return replace(config, heightmap_model=str(self.model))
        return replace(config, policy_model=str(self.model))

    def _figures(
        self, recording: "Recording", heightmaps: list[Heightmap], choice: "ScanChoice | None"
    ) -> dict[str, object]:
        """Figures of heights beside the simulator's ground."""
        statuses = dict(Counter(map(_status, heightmaps)))
        if choice is None:
            truths = {m.step: m.height for m in recording.of(GroundTruth)}
            return {
                "status": statuses,
                "mae_recorded_m": _error(recording.of(Heightmap), truths),
                "mae_replayed_m": _error(heightmaps, truths),
            }
        from saltus.heightmap.evaluation.scan_replay import draw_scan, scan_errors

        if self.picture is not None:
            draw_scan(self.picture, recording, choice.grid, heightmaps)
        return {"status": statuses, **scan_errors(recording, choice.grid, heightmaps)}

    def _tell(self, table: dict[str, object]) -> int:
        if self.json:
            print_json(table)
        else:
            print_figures(
                {
                    n: value
                    for n, value in without_infinities(table).items()
                    if value not in ({}, [])
                }
            )
        return 0

    def _tell_profile(self, table: dict[str, object], last: Heightmap) -> int:
        """A table, and the profile that it ends with."""
        if self.json:
            print_json(table)
            return 0
        self._tell({k: v for k, v in table.items() if k == "lost" or not isinstance(v, list)})
        _print_profile(last)
        return 0

    def _bag(self) -> tuple[dict[str, object], Heightmap]:
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
        profile, last = self._standing(load_robot(self.robot), read, invalid)
        table = {
            "recording": str(self.recording),
            "frames": len(invalid),
            "size": f"{first.depth.shape[1]}x{first.depth.shape[0]}",
            "depth_unit_m": first.depth_unit_m,
            "invalid_fraction": float(np.mean(invalid)),
            **profile,
        }
        return table, last

    def _level(self, recording: "Recording") -> tuple[dict[str, object], Heightmap]:
        from saltus.heightmap.evaluation.comparison import lost_note

        frames = sum(1 for _ in recording.payloads("camera/depth"))
        if not frames:
            raise RecordingError(f"{self.recording} has no depth image{lost_note(recording.lost)}")
        start = {"recording": str(self.recording), "lost": recording.lost, "frames": frames}
        profile, last = self._standing(recording.robot, partial(_frames, recording), [])
        return {**start, **profile}, last

    def _standing(
        self,
        robot: "Robot",
        read: Callable[[], Iterator[DepthFrame]],
        invalid: list[float],
    ) -> tuple[dict[str, object], Heightmap]:
        """How a standing robot sees the images, and the last heightmap.

        Appends each image's share without depth.
        """
        from saltus.heightmap.service.network import HeightmapNetwork
        from saltus.heightmap.service.replay import replay_standing
        from saltus.heightmap.service.steady_stamps import SteadyStamps
        from saltus.used_networks import model_path

        network = HeightmapNetwork(robot, model_path("heightmap", self.model))
        stamps, statuses, last, before = SteadyStamps(), Counter[str](), None, None
        for frame, last in replay_standing(network, read, self.level):
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
        return {"heightmaps": statuses.total(), "status": dict(statuses), **jumps, **arrays}, last


def _frames(recording: "Recording") -> Iterator[DepthFrame]:
    """Depth images of a recording, one after the other."""
    return (
        frame for _, _, frame in recording.messages("camera/depth") if isinstance(frame, DepthFrame)
    )


def _print_profile(heightmap: Heightmap) -> None:
    print("ahead [m]   height [m]   90 % of errors are below [m]")
    for (x, _), height, half in zip(
        points_of(heightmap), heightmap.height, heightmap.half_width_90, strict=True
    ):
        print(f"{x:9.3f}   {height:10.3f}   {half:10.3f}")


def _show(bar: Bar, stage: str, end_ns: int, arrival: "RecordedMessage") -> None:
    bar.at(stage, arrival.arrival_ns / end_ns)


def _compared(comparison: "AnswerComparison") -> dict[str, object]:
    """A comparison as a table."""
    return {
        "messages": {topic: asdict(counts) for topic, counts in comparison.topics.items()},
        "differences": {name: asdict(row) for name, row in comparison.fields.items()},
        "first_difference": None if comparison.first is None else str(comparison.first),
    }


def _must_repeat(recording: "Recording", config: "RunConfig") -> bool:
    """True where the same process, with the same networks,
    heard all of a run that came to its own end.
    """
    from saltus.recordings.summary import OUTCOME_CODES
    from saltus.used_networks import network_names

    return (
        config.pace == "lockstep"
        and recording.complete
        and any(event.code in OUTCOME_CODES for event in recording.of(Event))
        and network_names(config) == recording.models
    )


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
