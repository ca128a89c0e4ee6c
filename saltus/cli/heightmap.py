"""`saltus heightmap`: the service, and all that makes and measures its models."""

import contextlib
import itertools
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import subcommand

from saltus.cli.heightmap_data import CollectCommands, Dagger, DatasetCommands
from saltus.cli.heightmap_measures import Check, EvalHeightmap, ReportHeightmap
from saltus.cli.heightmap_train import ExportHeightmap, TrainHeightmap
from saltus.cli.scan_options import ScanOptions
from saltus.cli.serve import serve_module
from saltus.config import RunConfig
from saltus.errors import ConfigError, RecordingError, SaltusError
from saltus.flags import CommandGroup, Flag, Subcommands, flag_help
from saltus.heightmap.level_robot import LevelRobot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.wire import codec
from saltus.wire.bus import Publisher, topic_of
from saltus.wire.messages import DepthFrame, Heightmap, HeightmapStatus, Message
from saltus.wire.topics import TOPICS, Topic

if TYPE_CHECKING:
    from saltus.heightmap.service.network import HeightmapNetwork
    from saltus.heightmap.service.scan_fleet import ScanChoice
    from saltus.recordings.recording import RecordedMessage
    from saltus.runtime.replay import ReplayedMessage


@dataclass(frozen=True, kw_only=True)
class ServeHeightmap(ScanOptions):
    """Runs the heightmap service: against a running stack, or on a recording.

    The line of the Go1 by default. With --grid scan 187 points, 1.6 x 1.0 m, of any robot and any
    depth cameras.

    For example:
      saltus router --out runs/one
      saltus heightmap serve --run-dir runs/one --robots robot/0 robot/1
      saltus heightmap serve --run-dir runs/one --grid scan --dialect isaaclab --cameras front.toml --body none
      saltus heightmap serve --recording runs/one/recording.mcap --grid scan
      saltus heightmap serve --recording desk.bag --assume-level --base-height-m 0.3
    """

    endpoint: Annotated[
        str | None,
        flag_help(
            "STR",
            "the one that the folder names; with --recording and no folder a router of its own",
        ),
    ] = None
    """Zenoh router, e.g. tcp/127.0.0.1:7447."""
    run_dir: Annotated[Path | None, flag_help("PATH", "none, which --recording alone allows")] = (
        None
    )
    """Folder of the run: of `saltus up` or `saltus router`."""
    model: Annotated[Path | None, flag_help("PATH", "the shipped network")] = None
    """With a grid: ONNX file of its network."""
    recording: Annotated[Path | None, flag_help("PATH", "none: a running stack")] = None
    """With a grid a run (.mcap), else a RealSense recording (.bag, .db3) in place of a camera, with
    --assume-level."""
    assume_level: Flag = False
    """With --recording: take the robot to stand still and level."""
    robot: str = DEFAULT_ROBOT
    """Robot of a RealSense recording: name, or path of an MJCF or of a folder with a robot.toml."""
    level: Annotated[LevelRobot, tyro.conf.arg(name="")] = field(default_factory=LevelRobot)
    robots: Annotated[tuple[str, ...], flag_help("PREFIX [PREFIX ...]", "the one of run.toml")] = ()
    """Prefixes of the robots to serve, e.g. robot/0 robot/1."""
    peer: Flag = False
    """Link to the robots directly; the router must be on this machine, not behind a tunnel."""
    prefix: str = RunConfig.prefix
    """With --recording: of the keys."""
    beside: Flag = False
    """With a grid, in a running stack: another service answers the planner, and these heights come
    under scan/heightmap."""

    def run(self) -> int:
        """Runs until it is told to stop, or until the recording ends."""
        if self.recording is not None:
            choice = self.scan_choice(self.model)
            return (
                self._serve_recording(self.recording)
                if choice is None
                else self._serve_run(self.recording, choice)
            )
        from saltus.runtime.run_folder import read_config

        if self.run_dir is None:
            raise SaltusError("heightmap serve needs --run-dir (see saltus router), or --recording")
        grid = self.grid or read_config(self.run_dir).grid
        # What is wrong with it is said at once
        if replace(self, grid=grid).scan_choice(self.model) is None and self.beside:
            raise ConfigError("--beside needs a grid: --grid scan")
        robots = ["--robots", *self.robots] if self.robots else []
        model = ["--model", str(self.model)] if self.model is not None else []
        beside = ["--beside"] if self.beside else []
        more = (*robots, *self.scan_flags, *model, *beside)
        return serve_module("saltus.heightmap", self.run_dir, self.endpoint, *more, peer=self.peer)

    def _serve_recording(self, recording: Path) -> int:
        """Publishes depth and heightmaps of a recording at its own pace, image by image."""
        from saltus.heightmap.service.network import HeightmapNetwork
        from saltus.recordings.realsense import read_realsense
        from saltus.resources import shipped_file
        from saltus.robots.loading import load_robot

        frames = read_realsense(recording)
        first = next(frames, None)
        if first is None:
            raise RecordingError(f"{recording} holds no depth image")
        if not self.assume_level:
            raise RecordingError(f"{recording} has no robot state: add --assume-level")
        network = HeightmapNetwork(load_robot(self.robot), shipped_file("models/heightmap.onnx"))
        with contextlib.ExitStack() as resources:
            self._publish(self._endpoint(resources), network, itertools.chain([first], frames))
        return 0

    def _serve_run(self, path: Path, choice: "ScanChoice") -> int:
        """Publishes states, images and heights of a recorded run at its own pace."""
        from saltus.recordings.recording import read_recording
        from saltus.runtime.replay import body_of, replay_process
        from saltus.wire.zenoh_bus import ZenohBus

        recording = read_recording(path)
        with (
            contextlib.ExitStack() as resources,
            ZenohBus(self._endpoint(resources), self.prefix) as bus,
        ):
            publishers: dict[str, Publisher] = {}
            begun_s, first_ns = time.monotonic(), recording.span_ns[0]

            def publish(key: str, message: Message, topic: Topic) -> None:
                if key not in publishers:
                    suffix = key.removeprefix(topic.name).lstrip("/")
                    publishers[key] = bus.publisher(topic.name, suffix)
                publishers[key].put(message)

            def heard(arrival: "RecordedMessage") -> None:
                due_s = begun_s + 1e-9 * (arrival.arrival_ns - first_ns)
                time.sleep(max(0.0, due_s - time.monotonic()))
                topic = topic_of(arrival.key)
                assert topic is not None  # noqa: S101 - the service hears known topics
                publish(arrival.key, codec.decode_message(topic.message, arrival.payload), topic)

            def said(answer: "ReplayedMessage") -> None:
                if isinstance(answer.message, Heightmap):
                    publish(answer.key, answer.message, TOPICS["heightmap/heightmap"])

            body = partial(body_of("heightmap"), scan=choice)
            replay_process("heightmap", recording, said, heard=heard, body=body)
        return 0

    def _endpoint(self, resources: contextlib.ExitStack) -> str:
        """The router that was named, or one of its own until `resources` are closed."""
        from saltus.runtime.run_folder import endpoint_of
        from saltus.wire.router import open_router

        endpoint = self.endpoint or (
            endpoint_of(self.run_dir) if self.run_dir is not None else None
        )
        if endpoint is None:
            endpoint, router = open_router()
            resources.callback(router.close)
        print(f"serving at {endpoint}, keys under {self.prefix}", flush=True)
        return endpoint

    def _publish(
        self, endpoint: str, network: "HeightmapNetwork", frames: Iterator[DepthFrame]
    ) -> None:
        from saltus.heightmap.service.replay import replay_level
        from saltus.heightmap.service.steady_stamps import SteadyStamps
        from saltus.wire.zenoh_bus import ZenohBus

        stamps = SteadyStamps()
        steady = (replace(frame, time_ns=stamps.step(frame.time_ns)) for frame in frames)
        with ZenohBus(endpoint, self.prefix) as bus:
            depth, heights = bus.publisher("camera/depth"), bus.publisher("heightmap/heightmap")
            before_ns: int | None = None
            for frame, heightmap in replay_level(network, steady, self.level):
                if before_ns is not None:
                    time.sleep(min(1e-9 * (frame.time_ns - before_ns), stamps.period_s))
                before_ns = frame.time_ns
                depth.put(frame)
                heights.put(heightmap)
                print(f"frame {frame.frame_id}: {HeightmapStatus(heightmap.status).name.lower()}")
        if stamps.count:
            print(f"saltus: {self.recording}: {stamps.note()}", file=sys.stderr)


@dataclass(frozen=True, kw_only=True)
class Give:
    """Gives a model to a heightmap service that runs in real time,
    which checks it and warms it up first.

    Ends when the check is over: with 0 where the model is accepted, with 1 where it is refused. The
    service's events say when each robot has it.

    Example: saltus heightmap give runs/heightmap/heightmap.onnx --run-dir runs/one
    """

    model: tyro.conf.Positional[Path]
    """ONNX file, with its .sha256 beside it."""
    run_dir: Path
    """Folder with the run's run.toml."""

    def run(self) -> int:
        """Checks the file, puts it where the service looks, and says what became of it."""
        from saltus.heightmap.service.model_inbox import give_model, wait_for_answer

        model_id = give_model(self.model, self.run_dir)
        print(f"model {model_id} is in {self.run_dir}: waiting for the service", file=sys.stderr)
        refusal = wait_for_answer(self.run_dir)
        print(f"model {model_id} is {f'refused: {refusal}' if refusal else 'accepted'}")
        return 1 if refusal else 0


@dataclass(frozen=True, kw_only=True)
class HeightmapCommands(CommandGroup):
    """The heightmap: serve, check, give, collect, dagger, dataset, train, export, eval, report.

    A --model is an ONNX file, a --checkpoint the file of a training (.pt), from which `export`
    makes a model.
    """

    command: Subcommands[
        Annotated[ServeHeightmap, subcommand("serve")]
        | Check
        | Give
        | Annotated[CollectCommands, subcommand("collect")]
        | Dagger
        | Annotated[DatasetCommands, subcommand("dataset")]
        | Annotated[TrainHeightmap, subcommand("train")]
        | Annotated[ExportHeightmap, subcommand("export")]
        | Annotated[EvalHeightmap, subcommand("eval")]
        | Annotated[ReportHeightmap, subcommand("report")]
    ]
