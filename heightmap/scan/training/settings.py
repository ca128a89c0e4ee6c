"""Settings of flights, network and training of the scan."""

from dataclasses import dataclass, field

from saltus.config import TomlValue, check_between
from saltus.errors import ConfigError, nearest_hint
from saltus.heightmap.scan.settings import MapSettings

EVALUATED = (
    "flat", "rubble", "blocks", "strips", "stairs", "pyramid", "ramps", "stones", "stones_line",
    "ditches", "hurdles",
    "walls", "clutter", "rough", "hills",
)  # fmt: skip
"""Kinds of ground of the evaluation; dense stones have a row of their own."""
FAMILIES = (*EVALUATED, "stones_dense")
"""Kinds of ground."""
GAITS = ("walk", "trot", "bound", "hand")
"""Kinds of motion."""


@dataclass(frozen=True, kw_only=True)
class FlightSettings(TomlValue):
    """Settings of simulated flights: from what ground, motion, mounts, cameras and odometry are
    drawn.

    Raises:
        ConfigError: a number out of its range, or an unknown family or gait.
    """

    families: tuple[str, ...] = FAMILIES
    """Kinds of ground, equally often."""
    gaits: tuple[str, ...] = ("walk", "trot", "bound", "hand")
    patch_m: float = 6.4
    """Side of the ground of one robot, rasterised at `raster_m`; beyond it goes on as at its
    border [m]."""
    raster_m: float = 0.01
    trench_m: tuple[float, float] = (0.05, 1.5)
    """Depths of trenches and ditches, drawn evenly in their logarithm [m]."""
    rows: int = 48
    """Rays of an image."""
    columns: int = 64
    samples: int = 96
    """Places along a ray at which it is compared with the ground before the hit is bisected."""
    images: int = 48
    """Images of a flight."""
    rate_hz: tuple[float, float] = (10.0, 60.0)
    """Images a second, drawn evenly in their logarithm."""
    latency_s: tuple[float, float] = (0.02, 0.2)
    height_m: tuple[float, float] = (0.15, 1.7)
    """Height of the camera above the ground [m], drawn evenly in its logarithm."""
    above_m: tuple[float, float] = (-0.08, 0.25)
    """By how much the camera is above the base [m]."""
    ahead_m: tuple[float, float] = (-0.05, 0.35)
    """By how far it is before the base's middle, towards where it looks [m]."""
    down_deg: tuple[float, float] = (0.0, 85.0)
    """By how much the camera looks down."""
    look_deg: float = 0.0
    """Where a camera looks that is to look ahead: 90 is to the left, -90 to the right."""
    aim_deg: float = 7.0
    """Standard deviation of that direction."""
    rolled: float = 0.25
    """Share of cameras that are rolled by any angle up to 90 degrees."""
    turned: float = 0.25
    """Share of cameras that look to any side."""
    pairs: float = 0.15
    """Share of robots with a second camera, with half of the columns each."""
    fov_deg: tuple[float, float] = (40.0, 125.0)
    shape: tuple[float, float] = (0.5, 0.8)
    """Height of the image by its width."""
    pitch_deg: tuple[float, float] = (8.0, 50.0)
    """Greatest pitch of a bounding robot."""
    speed_mps: float = 1.5
    """The fastest."""
    feet: float = 0.5
    """Share of robots that tell standing feet."""
    velocity: float = 1.0
    """Share of robots that tell how they move; the odometry of the others stands still, but
    turns."""
    errors: float = 1.0
    """Errors of the images: 1 as drawn, 0 none."""
    calibration: tuple[float, float] = (0.0, 2.0)
    """Errors of mounts and scales of cameras, in units of usual ones, drawn evenly."""
    odometry: tuple[float, float] = (0.0, 2.2)
    """Errors of the odometry, drawn evenly: 0 none, 1 usual (speed off by 3 %), 2 bad."""

    def __post_init__(self) -> None:
        for name, known in (("families", FAMILIES), ("gaits", GAITS)):
            for value in getattr(self, name):
                if value not in known:
                    raise ConfigError(f"{name}: '{value}' is none: {nearest_hint(value, known)}")
            if not getattr(self, name):
                raise ConfigError(f"{name} is empty: name one at least")
        share = (0.0, 1.0)
        check_between(
            self, patch_m=(1.0, 50.0), raster_m=(0.002, 0.1), trench_m=(0.001, 5.0), rows=(4, 1024),
            columns=(4, 1024),
            samples=(4, 1024), images=(2, 10_000), rate_hz=(1.0, 200.0), latency_s=(0.0, 0.5),
            height_m=(0.05, 3.0),
            down_deg=(-30.0, 90.0), look_deg=(-180.0, 180.0),
            above_m=(-1.0, 1.0), ahead_m=(-1.0, 1.0), aim_deg=(0.0, 180.0),
            shape=(0.1, 10.0),
            rolled=share, turned=share, pairs=share, fov_deg=(5.0, 150.0),
            pitch_deg=(0.0, 80.0), speed_mps=(0.0, 5.0), feet=share, velocity=share,
            errors=(0.0, 3.0), calibration=(0.0, 10.0),
            odometry=(0.0, 10.0),
        )  # fmt: skip

    @property
    def raster(self) -> int:
        """Cells along each side of the ground of one robot."""
        return round(self.patch_m / self.raster_m)


@dataclass(frozen=True, kw_only=True)
class NetworkSettings(TomlValue):
    """Sizes of the scan's network.

    Raises:
        ConfigError: a size that no network has.
    """

    channels: tuple[int, int, int, int] = (32, 40, 56, 64)
    """At the cells, and at each of three coarser levels."""
    memory: bool = True
    """It is shown what it told last; without, it is a residual on the map alone."""
    frame: bool = False
    """It is shown each image alone, without the map and without memory; what it tells is fused by
    its half-widths afterwards: the rival of `saltus.heightmap.scan.training.framewise`."""
    deep: int = 4
    """Residual blocks at the coarsest level, which sees the whole window."""
    deep_channels: int = 128
    features: float = 30.0
    """Root mean square beyond which a cell's features are scaled back to it, at every level; 0: they
    may grow without bound. A trained network's are 1 to 7 on average, 8 to 38 in one cell of a
    hundred and 50 at most. Without a bound, seed 32 went astray after 1,100 updates; with 30, none
    of seeds 31, 32 and 33 did (docs/history.md, "Trainings of the scan from nothing")."""
    choice: bool = True
    """A cell's height is a choice among heights that the map offers, beside the network's own: a
    cell at an edge is top or bottom."""

    def __post_init__(self) -> None:
        if self.frame and self.memory:
            raise ConfigError(
                "frame: a network that is shown each image alone has no memory: memory = false"
            )
        check_between(
            self, channels=(1, 1024), deep=(0, 64), deep_channels=(1, 4096), features=(0.0, 1e6)
        )


@dataclass(frozen=True, kw_only=True)
class ScanTrainSettings(TomlValue):
    """Settings of one training of the scan's network.

    Raises:
        ConfigError: a number out of its range.
    """

    map: MapSettings = field(default_factory=MapSettings)
    flight: FlightSettings = field(default_factory=FlightSettings)
    network: NetworkSettings = field(default_factory=NetworkSettings)
    batch: int = 256
    """Robots at once; each of their images is an example."""
    round: int = 192
    """Updates from one set of flights to the next; a checkpoint goes on at the beginning of a
    round."""
    learning_rate: float = 1e-3
    blocks_rate: float = 0.1
    """Learning rate of the blocks at the coarsest level, as a share of the others'. At the same
    rate, the last of four blocks adds 65 times what comes into the first after 100 updates; at a
    tenth, 0.14 times (seed 31, root mean squares)."""
    weight_decay: float = 1e-4
    gradient_norm: float = 1.0
    average: float = 0.998
    """Share that an update leaves of the average of weights that is kept as the network."""
    seed: int = 0

    def __post_init__(self) -> None:
        check_between(
            self, batch=(1, 65_536), round=(1, 1_000_000), learning_rate=(0.0, 1.0),
            blocks_rate=(0.0, 10.0), weight_decay=(0.0, 1.0),
            gradient_norm=(1e-3, 1e6), average=(0.0, 1.0), seed=(0, 2**31),
        )  # fmt: skip
