"""Settings of collections and trainings: each dataclass is the TOML file
and the flags of its command.
"""

import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from saltus.config import UNNAMED, check_between
from saltus.effects.profile import SHIPPED
from saltus.errors import ConfigError
from saltus.flags import Flag

BackEndName = Literal["embree", "pyrender", "warp"]
DeliveryName = Literal["training", "nominal", "at-once"]
"""How late images come: as drawn for training, as in a run without delays of its own, or at
once."""
VARIATION = 0.15
"""Standard deviation of each of the scripted planner's numbers, as a share of it."""
MIN_TICKS = 60  # the first 0.5 s are warm-up; of a shorter run nothing would be left
FIRST_RATE = 1e-3  # original
FURTHER_RATE = 5e-4  # of a network that already predicts: the full rate would first make it forget
MOST_DIFFICULT = 1.2  # a fifth beyond what the policy was trained for
LARGEST = 2**20
"""Largest number of robots, ticks, windows, neurons: more of them fill any memory before the work
begins."""
MANY = 10**9
"""Largest number of updates, episodes, rounds: what takes time, not memory."""
SEEDS = (0, 2**53)
USUAL_RENDERER: BackEndName = "embree"
USUAL_TERRAINS = ("flat", "stairs", "stairs", "stepping_stones", "stepping_stones", "step", "gap")
"""Those of manifests that name none, as `USUAL_RENDERER`."""
TERRAINS = (*USUAL_TERRAINS, "stairs_down", "step_down", "pyramid", "irregular", "hurdles", "ditch")
"""Stairs and stones twice: there the heights matter most, and there they were worst."""
_SHARE = (0.0, 1.0)
_NONE = "(default: none, true heights)"


@dataclass(frozen=True, kw_only=True)
class ModelSettings:
    """Sizes of the line's heightmap network.

    Raises:
        ConfigError: a layer without neurons, or with more than fit into a memory.
    """

    channels: tuple[int, int, int] = (8, 16, 16)
    """Channels of the three convolutions; original: 2, 4, 8."""
    hidden: int = 256
    """Size of the hidden state of the GRU."""
    head: tuple[int, ...] = (256, 256)
    """Hidden layers after the GRU; original: three."""

    def __post_init__(self) -> None:
        check_between(self, channels=(1, LARGEST), hidden=(1, LARGEST), head=(1, LARGEST))


@dataclass(frozen=True, kw_only=True)
class PredictorTraining:
    """Settings of one training of the line's heightmap network. The defaults fit two CPU cores for
    minutes; on a GPU raise `updates` and `batch`.

    Raises:
        ConfigError: a number that cannot be; the message names it.
    """

    updates: int = 1500
    """Gradient steps in all."""
    batch: int = 32
    """Windows in a gradient step; 1024 fill a GPU."""
    window: int = 100
    """Ticks of 10 ms in a window.

    The hidden state is carried across windows, its gradient is not.
    """
    learning_rate: float = FIRST_RATE
    """Greatest rate, after the warm-up; by default 0.0005 where it begins with another network."""
    weight_decay: float = 0.01  # original
    """Weight decay of AdamW."""
    gradient_norm: float = 1.0
    """A longer gradient is cut to this."""
    noise: bool = True
    """Errors on the images, as far as they do not have them.

    Without it a network learns from what is in the data.
    """
    delivery: DeliveryName = "training"
    """Delivery of the images. training: 30 to 110 ms late with jitter, losses and pauses. nominal:
    50 ms late, none lost. at-once: neither late nor lost."""
    forgets: float = 0.4
    """Share of windows before which the hidden state is emptied on the way,
    as after a long loss of images: its first half second is then learned as well as the rest."""
    seed: int = 0
    """Seed of weights, batches and noise."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to train; auto: on a GPU where there is one."""
    save_every_s: float = 60.0
    """Time between checkpoints [s]."""
    model: ModelSettings = field(default_factory=ModelSettings)

    def __post_init__(self) -> None:
        check_between(
            self, updates=(1, MANY), batch=(1, LARGEST), window=(1, LARGEST), learning_rate=_SHARE,
            weight_decay=_SHARE,
            gradient_norm=(1e-9, 1e9), forgets=_SHARE, seed=SEEDS, save_every_s=(0.0, math.inf),
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class LoopSettings:
    """Settings of robots that are let run to collect data: how many at a time, on which terrains.

    Raises:
        ConfigError: a number that leaves no robots, no time, or no course.
    """

    robot: str
    """Their kind: a robot that Saltus ships, or the path of an MJCF or of a folder with a
    robot.toml."""
    grid: str
    """Grid of the heights: a name, or path of a TOML file (`saltus.grid`)."""
    robots: int
    ticks: int = 600
    """Ticks of 10 ms, of every robot; one that falls or arrives starts again, which begins another
    episode."""
    hardest: float
    learned: float
    """Share of robots that the learned policy drives; the scripted planner drives the others."""
    variation: float = VARIATION
    """Standard deviation of each of the scripted planner's numbers, as a share of it."""
    terrains: tuple[str, ...] = TERRAINS
    """Families of the courses, drawn evenly from this list: who stands in it twice is drawn twice
    as often. ramp_up, ramp_down and families of your own are named like the others."""

    def __post_init__(self) -> None:
        check_between(
            self, robots=(1, LARGEST), ticks=(MIN_TICKS, LARGEST), hardest=(0.0, MOST_DIFFICULT),
            learned=_SHARE,
            variation=_SHARE,
        )  # fmt: skip
        if not self.terrains:
            raise ConfigError("terrains = (): name at least one")

    @property
    def table(self) -> dict[str, object]:
        """Table for a manifest: of robots, grids,
        terrains and renderers only others than older manifests mean.
        """
        usual = {
            **UNNAMED,
            "terrains": list(USUAL_TERRAINS),
            "renderer": USUAL_RENDERER,
            "plans": False,
        }
        table = asdict(self) | {"terrains": list(self.terrains)}
        return {
            name: value
            for name, value in table.items()
            if name not in usual or value != usual[name]
        }


@dataclass(frozen=True, kw_only=True)
class ClosedLoop(LoopSettings):
    """Settings of robots that run on processors with a predictor in the loop, a batch at a time."""

    robots: int = 32
    """In a batch."""
    courses: int = 8
    """Different terrains in a batch: the images of robots on the same one are taken together."""
    hardest: float = 0.8
    """Courses go up to this difficulty, that of the paper's. There the scripted planner falls,
    and the learned one with poor heights: falls are part of what must be seen."""
    learned: float = 0.5
    """Share of robots that the learned policy drives; the scripted planner drives the others."""
    camera: str = "d435i"
    """Takes the images that are kept. d435i: stereo errors of different strength for each robot.
    ideal: true depth. Or a TOML file. The predictor in the loop sees true depth: what it costs a
    robot to step a little worse is not worth the time."""
    renderer: Annotated[BackEndName, tyro.conf.arg(aliases=["--renderer"])] = USUAL_RENDERER
    """Back end that renders these images."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_between(self, hardest=_SHARE)
        if not 1 <= self.courses <= self.robots:
            raise ConfigError(
                f"courses = {self.courses}: it must be from 1 to robots = {self.robots}"
            )


@dataclass(frozen=True, kw_only=True)
class DaggerSettings:
    """Settings of DAgger rounds of the line's heightmap network; all of it but the number of rounds
    stays as it was begun.

    Raises:
        ConfigError: no rounds, no batches, or no updates.
    """

    rounds: int = 3
    """In all; a run may go on for more."""
    batches: int = 8
    """In a round, each of `loop.robots` robots."""
    updates: int = 1500
    """Gradient steps in a round."""
    batch: int = 32
    """Windows in a gradient step."""
    seed: int = 0
    """Seed of terrains, trials, cameras, weights and noise."""
    profile: str = SHIPPED
    """Hardware of the robots and how their cameras sit:
    shipped (those of the robot), ideal, one of your own, or a TOML file."""
    loop: ClosedLoop

    def __post_init__(self) -> None:
        check_between(
            self,
            rounds=(1, MANY),
            batches=(1, MANY),
            updates=(1, MANY),
            batch=(1, LARGEST),
            seed=SEEDS,
        )


@dataclass(frozen=True, kw_only=True)
class ProcessorCollection:
    """Settings of episodes that are collected on processors, driven by rules or by the policy.

    Raises:
        ConfigError: no batches, or a seed that is none.
    """

    batches: int = 8
    """Each of `loop.robots` robots."""
    seed: int = 0
    """Seed of terrains, trials and cameras."""
    profile: str = SHIPPED
    """Hardware of the robots and how their cameras sit:
    shipped (those of the robot), ideal, one of your own, or a TOML file."""
    model: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint=_NONE)] = None
    """ONNX file of the predictor in the loop."""
    loop: ClosedLoop

    def __post_init__(self) -> None:
        check_between(self, batches=(1, MANY), seed=SEEDS)


@dataclass(frozen=True, kw_only=True)
class DeviceLoop(LoopSettings):
    """Settings of a collection of data on one device: thousands of robots run there at once."""

    robots: int = 4096
    """At once: 2.5 GB of a GPU's memory for what 6 s of them leave."""
    hardest: float = 1.0
    """Courses go up to this difficulty, evenly. At 1 they are those of the policy's training;
    up to 1.2, as falls are part of what must be seen."""
    learned: float = 1.0
    """Share of robots that the learned policy drives; the scripted planner drives the others."""
    cameras: tuple[str, ...] = ("d435i",)
    """Cameras whose images are kept, of the same motion; the predictor in the loop sees those of
    the first. d435i: with the errors of a stereo camera. ideal: true depth. Or TOML files."""
    plans: Flag = False
    """Keep what the policy sees of the robot, and what it plans on true heights: what an imitation
    of it needs."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.cameras or len(set(self.cameras)) < len(self.cameras):
            raise ConfigError(f"cameras = {self.cameras}: name each once, and at least one")


@dataclass(frozen=True, kw_only=True)
class DeviceCollection:
    """Settings of episodes that are collected on a GPU, driven by the policy.

    Raises:
        ConfigError: no robots, or a seed that is none.
    """

    episodes: int = 4096
    """How many robots in all, in equal batches; falls make more episodes of them."""
    seed: int = 0
    """Seed of courses, robots and cameras."""
    policy: Annotated[
        Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="(default: the shipped one)")
    ] = None
    """The policy: an ONNX file, or the checkpoint of a training."""
    predictor: Annotated[
        Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="(default: true heights)")
    ] = None
    """Checkpoint of the predictor in the loop."""
    profile: Annotated[
        str | None,
        tyro.conf.arg(metavar="STR", help_behavior_hint="(default: that of the policy's training)"),
    ] = None
    """Hardware of the robots and of their cameras: shipped, ideal, one of your own, or a TOML
    file."""
    device: Literal["cuda", "cpu"] = "cuda"
    """Where all of it runs."""
    loop: DeviceLoop

    def __post_init__(self) -> None:
        check_between(self, episodes=(1, MANY), seed=SEEDS)

    @property
    def batches(self) -> int:
        """Batches of at most `loop.robots` robots."""
        return -(-self.episodes // self.loop.robots)
