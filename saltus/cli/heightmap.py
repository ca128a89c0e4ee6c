"""`saltus heightmap`: serve, give, collect, train, export."""

import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from tqdm import tqdm
from tyro.conf import subcommand

from saltus import go1
from saltus.cli.heightmap_data import Dagger, Dataset
from saltus.cli.heightmap_eval import Eval
from saltus.cli.heightmap_report import Report
from saltus.cli.serve import Peer, serve
from saltus.config import DEFAULT_ROBOT, Camera, RunConfig, check_at_least
from saltus.errors import SaltusError
from saltus.heightmap.data.delivery import DeliveryName
from saltus.policy.training.command import TRAINING

if TYPE_CHECKING:
    from saltus.heightmap.data.shards import ShardRecord
    from saltus.heightmap.training.train import Progress

CHECKPOINT = Path("runs/heightmap.pt")
TRIALS = 1_000_000
"""Seeds of trials in a round of data: rounds with different seeds, and evaluations, never meet the same trial."""
ROBOTS = 4096
"""At most at once on a GPU: 2.5 GB of its memory for what 6 s of them leave."""


@dataclass(frozen=True, kw_only=True)
class Serve:
    """Runs the heightmap service: against a running stack, or on a RealSense recording."""

    endpoint: str | None = None
    """Zenoh router, e.g. tcp/127.0.0.1:7447; with --recording, a router of its own where it is not given."""
    run_dir: Path | None = None
    """Folder with the run's run.toml."""
    recording: Path | None = None
    """A RealSense recording (.bag) in place of a camera; needs --assume-level."""
    assume_level: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """With --recording: take the robot to stand still and level."""
    base_height_m: float = go1.STAND_HEIGHT
    """With --assume-level: height of the base above the ground."""
    camera_pitch_deg: float = 29.8
    """With --assume-level: how far the camera looks down."""
    robots: tuple[str, ...] = ()
    """Prefixes of the robots to serve, e.g. robot/0 robot/1; the one of run.toml where none is given."""
    peer: Peer = False
    """Link to the robots directly; the router must be on this machine, not behind a tunnel."""
    prefix: str = RunConfig().prefix
    """With --recording: of the keys."""

    def run(self) -> int:
        """Runs until it is told to stop, or until the recording ends."""
        if self.recording is not None:
            return self._serve_recording(self.recording)
        if self.endpoint is None or self.run_dir is None:
            raise SaltusError("heightmap serve needs --endpoint and --run-dir, or --recording")
        robots = ("--robots", *self.robots) if self.robots else ()
        return serve("saltus.heightmap", self.run_dir, self.endpoint, *robots, peer=self.peer)

    def _serve_recording(self, recording: Path) -> int:
        """Publishes depth and heightmaps of a recording at its own pace."""
        from saltus.heightmap.service.replay import AssumeLevel, replay_frames
        from saltus.recordings.realsense import read_realsense
        from saltus.resources import resource
        from saltus.runtime.stack import open_router
        from saltus.wire.messages import HeightmapStatus
        from saltus.wire.zenoh_bus import ZenohBus

        frames = list(read_realsense(recording))
        if not self.assume_level:
            raise SaltusError(f"{recording} has no robot state: add --assume-level")
        robot = AssumeLevel(base_height_m=self.base_height_m, camera_pitch_deg=self.camera_pitch_deg)
        heightmaps = replay_frames(resource("models/heightmap.onnx"), frames, robot)
        endpoint, router = (self.endpoint, None) if self.endpoint else open_router()
        try:
            with ZenohBus(endpoint, self.prefix) as bus:
                depth, heights = bus.publisher("camera/depth"), bus.publisher("heightmap/heightmap")
                print(f"serving at {endpoint}, keys under {self.prefix}")
                before_ns = frames[0].time_ns
                for frame, heightmap in zip(frames, heightmaps, strict=True):
                    time.sleep(1e-9 * max(frame.time_ns - before_ns, 0))
                    before_ns = frame.time_ns
                    depth.put(frame)
                    heights.put(heightmap)
                    print(f"frame {frame.frame_id}: {HeightmapStatus(heightmap.status).name.lower()}")
        finally:
            if router is not None:
                router.close()
        return 0


@dataclass(frozen=True, kw_only=True)
class Give:
    """Gives a model to a heightmap service that runs in real time, where it is tried out and warmed up first."""

    model: tyro.conf.Positional[Path]
    """ONNX file, with its .sha256 beside it."""
    run_dir: Path
    """Folder with the run's run.toml."""

    def run(self) -> int:
        """Checks the file and puts it where the service looks."""
        from saltus.heightmap.service.model_inbox import give

        print(
            f"model {give(self.model, self.run_dir)} is in {self.run_dir}: the service's events say what becomes of it"
        )
        return 0


@dataclass(frozen=True, kw_only=True)
class Collect:
    """Adds a shard of labelled episodes to a dataset."""

    out: Path = Path("runs/dataset")
    """Folder of the dataset; it is made, or a shard is added to it."""
    source: Literal["planner", "policy"] = "planner"
    """planner: runs of the scripted planner in MuJoCo. policy: runs of the learned policy on a GPU, thousands of robots
    at once."""
    episodes: int = 200
    """How many episodes. With --source policy how many robots, for 6 s each: falls make more episodes of them."""
    seed: int = 0
    """Seed of terrains and trials."""
    profile: str = "shipped"
    """Hardware of the robots and how their cameras sit: shipped (those of the robot), ideal, one of your own, or a TOML
    file. With --source policy that of the policy's training."""
    policy: Path | None = None
    """With --source policy: checkpoint of the policy that leads; that of this checkout where it is not given."""
    predictor: Path | None = None
    """With --source policy: checkpoint of the predictor in the loop; true heights where it is not given."""
    camera: Camera | None = None
    """With --source policy. d435i, where it is not given: images with the errors of a stereo camera. ideal: true
    depth, as that of the other sources."""
    device: Literal["cuda", "cpu"] = "cuda"
    """With --source policy: where all of it runs."""

    def run(self) -> int:
        """Writes the shard, whole or not at all."""
        check_at_least(self, episodes=1)
        for name in ("policy", "predictor", "camera"):
            if self.source != "policy" and getattr(self, name) is not None:
                raise SaltusError(f"--{name} is for --source policy: '{self.source}' has none")
        record = self._on_device() if self.source == "policy" else self._on_processor()
        print(
            f"{self.out / record.file}: {record.episodes} episodes, {record.ticks} steps, sha256 {record.sha256[:16]}"
        )
        return 0

    def _on_device(self) -> "ShardRecord":
        try:
            from saltus.heightmap.data.device_rollouts import DeviceLoop
            from saltus.heightmap.training.gpu_rollouts import POLICY, BatchProgress, collect
            from saltus.resources import resource
        except ImportError as error:
            raise SaltusError(f"--source policy needs {error.name}: {TRAINING}") from error
        try:
            policy = self.policy or resource(str(POLICY))
        except SaltusError as error:
            raise SaltusError("only a checkout has a checkpoint of the policy: name one with --policy") from error
        batches, camera = -(-self.episodes // ROBOTS), self.camera or "d435i"
        with tqdm(total=batches, unit="batch", desc="collect") as bar:

            def show(batch: BatchProgress) -> None:
                bar.update()
                bar.set_postfix(steps=batch.ticks, steps_per_s=f"{batch.ticks / batch.seconds:.0f}")

            robots = -(-self.episodes // batches)
            loop = DeviceLoop(robots=robots, cameras=(camera,))
            records = collect(
                {camera: self.out}, loop, policy=policy, predictor=self.predictor,
                batches=batches, seed=self.seed, device=self.device, done=show,
            )  # fmt: skip
        return records[camera]

    def _on_processor(self) -> "ShardRecord":
        from saltus.effects.profile import load_profile
        from saltus.heightmap.data.planned import PlannedBounding
        from saltus.heightmap.data.rollouts import collect
        from saltus.robots.loading import load_robot

        profile = load_profile(self.profile, load_robot(DEFAULT_ROBOT))
        source = PlannedBounding(first_seed=TRIALS * (1 + self.seed), profile=profile)
        config = {"source": self.source, "episodes": self.episodes, "profile": self.profile}
        view = profile.view_chain
        with tqdm(total=self.episodes, unit="episode", desc="collect") as bar:
            return collect(
                self.out, source, count=self.episodes, seed=self.seed, config=config, view=view, done=bar.update
            )


@dataclass(frozen=True, kw_only=True)
class Train:
    """Trains the heightmap network on a dataset; the same command goes on from where it was interrupted."""

    data: Path = Path("runs/dataset")
    """Folder of the dataset."""
    checkpoint: Path = CHECKPOINT
    """Written about once a minute, and when it is interrupted. One of another training is left alone."""
    start: Path | None = None
    """Begin from the weights of another checkpoint, at a lower rate."""
    updates: int = 1500
    """Gradient steps in all."""
    batch: int = 32
    """Windows in a gradient step."""
    seed: int = 0
    """Seed of weights, batches and noise."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to train."""
    noise: bool = True
    """Errors on the images, as far as they do not have them; without it a network learns from what is in the data."""
    delivery: DeliveryName = "training"
    """Of the images. training: 30 to 60 ms late with jitter, losses and pauses. nominal: 50 ms late, none lost.
    at-once: neither late nor lost."""

    def run(self) -> int:
        """Trains, with a progress bar."""
        from saltus.heightmap.data.delivery import DELIVERIES
        from saltus.heightmap.training.dataset import NO_NOISE, TRAINING_NOISE
        from saltus.heightmap.training.train import FIRST_RATE, FURTHER_RATE, TrainConfig, train

        config = TrainConfig(
            updates=self.updates,
            batch=self.batch,
            learning_rate=FURTHER_RATE if self.start else FIRST_RATE,
            noise=TRAINING_NOISE if self.noise else NO_NOISE,
            delivery=DELIVERIES[self.delivery],
            seed=self.seed,
            device=self.device,
        )
        with tqdm(total=self.updates, unit="update", desc="train") as bar:

            def show(progress: "Progress") -> None:
                bar.update(progress.update - bar.n)
                bar.set_postfix(loss=f"{progress.loss:.3f}", mae_cm=f"{100 * progress.mae_m:.2f}")
                if progress.calibrates:
                    bar.set_description("calibrate")

            before = _written_ns(self.checkpoint)
            try:
                train(self.data, self.checkpoint, config, show, start=self.start)
            except KeyboardInterrupt:
                bar.close()
                kept = "what was learned is" if _written_ns(self.checkpoint) != before else "nothing new is"
                print(f"interrupted: {kept} in {self.checkpoint}", file=sys.stderr)
                raise
            bar.update(self.updates - bar.n)  # where all was done before
        print(self.checkpoint)
        return 0


def _written_ns(path: Path) -> int | None:
    """When a file was written; None where there is none."""
    return path.stat().st_mtime_ns if path.exists() else None


@dataclass(frozen=True, kw_only=True)
class Export:
    """Exports a checkpoint to ONNX, measures the file on held-out episodes, and writes its card."""

    data: Path = Path("runs/dataset")
    """Folder of the dataset that the checkpoint was trained on."""
    checkpoint: Path = CHECKPOINT
    """What to export."""
    out: Path = Path("runs/heightmap.onnx")
    """The file to write, .onnx; its checksum and its card go beside it."""
    unseen: Path | None = None
    """Dataset to measure on, of which nothing was trained on; of --data only manifest.json is needed then. Without it:
    the tenth of --data that training held out."""

    def run(self) -> int:
        """Writes the files and prints what was measured."""
        from saltus.heightmap.training.release import card_path, release

        if self.out.suffix != ".onnx":
            raise SaltusError(f"--out {self.out}: name a file that ends in .onnx")
        print("exporting and measuring; a minute for 100 episodes", file=sys.stderr)
        result = release(self.checkpoint, self.data, self.out, self.unseen)
        print(f"{self.out}  model {result.model_id}, warm after {result.warmup_frames} images")
        for images, found in (("images 50 ms late", result.clean), ("late with jitter and losses", result.faulty)):
            print(
                f"    {images}: {1e3 * found.mae_m:.1f} mm off, {100 * found.coverage90:.0f} % within the 90 % interval"
            )
        print(card_path(self.out))
        return 0


@dataclass(frozen=True, kw_only=True)
class Heightmap:
    """The heightmap: serve, give, collect, dagger, dataset, train, export, eval, report."""

    command: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[Serve, subcommand("serve")]
            | Annotated[Give, subcommand("give")]
            | Annotated[Collect, subcommand("collect")]
            | Annotated[Dagger, subcommand("dagger")]
            | Annotated[Dataset, subcommand("dataset")]
            | Annotated[Train, subcommand("train")]
            | Annotated[Export, subcommand("export")]
            | Annotated[Eval, subcommand("eval")]
            | Annotated[Report, subcommand("report")]
        ]
    ] = field()

    def run(self) -> int:
        """Runs the chosen command."""
        return self.command.run()
