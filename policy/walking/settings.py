"""Configuration of a walking training: the TOML file, the flags, and what a checkpoint holds."""

from dataclasses import dataclass, field, fields

from saltus.config import check_between
from saltus.errors import ConfigError
from saltus.policy.env.randomisation import RandomisationSettings
from saltus.policy.env.settings import LARGEST, MOST_ROBOTS, SMALLEST, LearningSettings
from saltus.policy.walking.starts import JumpStartSettings
from saltus.terrain.course_table import CourseTable


@dataclass(frozen=True, kw_only=True)
class GroundSettings:
    """Settings of the grounds of a walking training: kinds, levels, and which of a ground's boxes a
    robot has.
    """

    shares: dict[str, float] = field(
        default_factory=lambda: {
            "plain": 0.10,
            "rubble": 0.25,
            "stairs": 0.1,
            "stairs_down": 0.05,
            "irregular": 0.05,
            "stones": 0.1,
            "hurdles": 0.1,
            "ramp_up": 0.05,
            "ramp_down": 0.05,
            "flight": 0.15,
        }
    )
    """Share of the robots on each family of terrain, relative to the others.

    A robot stays on its family. A TOML file gives 0 to those that it does not want.
    """
    wide: tuple[str, ...] = ("plain", "rubble")
    """Families on which commands lead in any direction, and robots start anywhere."""
    levels: int = 10
    """Level k has difficulties from k / levels to (k + 1) / levels of the hardest."""
    hardest: float = 0.6
    """Difficulty at the end of the last level: stairs of 0.20 m, ramps of 18 degrees."""
    promotion: float = 0.8
    """Share of the commanded way that earns a harder ground; legged_gym's, half its patch."""
    demotion: float = 0.5
    """Less than this share of the commanded way leads to an easier ground; legged_gym."""
    boxes: int = 20
    """Boxes that a robot has at a time, those nearest to it: more cost time in every physics step.

    With 20, 0.2 % of the scan's points on rubble miss a box, on other ground less; none near the
    feet does.
    """
    margin_m: float = 0.5
    """A robot that comes so near to the rim of its ground starts anew [m]; it did not fail."""

    def __post_init__(self) -> None:
        check_between(self, levels=(1, 255), hardest=(0.0, 1.0), promotion=(0.0, 10.0))
        check_between(self, demotion=(0.0, 10.0), boxes=(1, 1000), margin_m=(0.0, 100.0))
        if any(share < 0.0 for share in self.shares.values()) or not sum(self.shares.values()):
            raise ConfigError(f"shares = {self.shares}: none may be negative, one must be above 0")

    @property
    def table(self) -> CourseTable:
        """The courses of all families, see `saltus.terrain.course_table`."""
        return CourseTable.of(tuple(self.shares), self.levels, self.hardest, self.boxes)


@dataclass(frozen=True, kw_only=True)
class VelocityCommandSettings:
    """Ranges of the velocities that walking robots are commanded in training, in the yaw frame of
    the base.
    """

    ahead_mps: tuple[float, float] = (-0.8, 1.2)
    """On wide ground."""
    aside_mps: float = 0.5  # +-
    turn_rps: float = 1.0  # +-
    along_mps: tuple[float, float] = (0.3, 1.2)
    """Ahead on ground that leads one way, where the heading is held."""
    along_aside_mps: float = 0.2  # +-
    heading_rad: float = 0.3  # +-; around the way that the ground leads
    heading_gain: float = 0.5
    """Turning rate by error of the heading [1/s]; legged_gym's."""
    middle_gain: float = 0.5
    """Heading towards the middle by the distance from it [rad/m]: robots stay on narrow ground."""
    standing: float = 0.1
    """Share of the commands that ask to stand still."""
    period_s: float = 5.0
    """Mean time until another command."""

    def __post_init__(self) -> None:
        check_between(self, ahead_mps=(-5.0, 5.0), along_mps=(-5.0, 5.0), aside_mps=(0.0, 5.0))
        check_between(self, turn_rps=(0.0, 10.0), along_aside_mps=(0.0, 5.0), standing=(0.0, 1.0))
        check_between(self, heading_rad=(0.0, 3.2), heading_gain=(0.0, 10.0))
        check_between(self, middle_gain=(0.0, 10.0), period_s=(0.02, LARGEST))


@dataclass(frozen=True, kw_only=True)
class WalkRewardSettings:
    """Weight of each term of the walking policy's reward, per second; IsaacLab's for the Go1 where
    nothing else is said.
    """

    linear_velocity: float = 1.5
    turning: float = 0.75
    vertical_velocity: float = -2.0
    roll_pitch_rate: float = -0.05
    tilt: float = -0.2
    """Tilt of the base against level; legged_gym's -0 on rough ground lets robots lean for good."""
    torque: float = -2e-4
    joint_acceleration: float = -2.5e-7
    action_rate: float = -0.01
    air_time: float = 1.0
    slip: float = -0.1
    collision: float = -1.0
    missed: float = -1.0
    """A foot that stands in a gap between stones, for each, as BeamDojo's; weighs like a knee."""
    edge: float = 0.0
    """A foot that stands beside a drop, for each: it has no room for an error of the next one."""
    hip: float = -0.1
    """Abduction away from the pose: feet stay below the hips."""
    still: float = -0.5
    """Joints away from the pose while the command is to stand, on level ground alone: the pose does
    not fit stairs, where legs have to bend unequally."""
    end: float = -100.0
    """A failure, which lasts one step: it costs two units of reward."""

    def __post_init__(self) -> None:
        check_between(self, **dict.fromkeys((f.name for f in fields(self)), (-1e6, 1e6)))


@dataclass(frozen=True, kw_only=True)
class ScanErrorSettings:
    """Errors of heights, at most as of the shipped scan on the Go1's mount (models/scan.md).

    Each episode has its own size of all errors of points, the square of a uniform number.
    """

    exact: float = 0.0
    """Share of the robots that are told true heights, without errors and of the same moment."""
    image_hz: float = 30.0
    """Heights are held from image to image; the D435i's rate."""
    seen_m: float = 0.0196
    """Standard deviation of points that were seen: the card's mean error, 15.6 mm, times 1.25."""
    unseen: float = 0.40
    """Standard deviation of other points, by the ground's own mean deviation from its mean.

    The card's 57.0 mm, where flat ground is off by 179.3 mm, times 1.25.
    """
    seen_x_m: float = 0.15
    seen_y_m: float = 0.35
    """Points this far ahead and no further aside are seen: 26 % of 187; the card has 27 %."""
    change_m: float = 0.3
    """Mean way until the error of a point is another one: what a standing robot sees stays wrong.

    Half a second at 0.6 m/s.
    """
    shift_m: float = 0.02
    """Up or down, all points alike, for an episode (+-): height of the base above its feet."""
    filled: float = 0.05
    """Share of the points in a gap of one spacing across the way that are told as high as its
    edges; the others are told as dips of any depth (`saltus.policy.walking.scan_errors`).

    The shipped scan of the whole image of a D435i on a Go2 that walks over stones: docs/walking.md.
    """

    def __post_init__(self) -> None:
        check_between(self, image_hz=(SMALLEST, 50.0), seen_m=(0.0, 1.0), unseen=(0.0, 10.0))
        check_between(self, exact=(0.0, 1.0), seen_x_m=(-10.0, 10.0), seen_y_m=(0.0, 10.0))
        check_between(self, change_m=(SMALLEST, LARGEST), shift_m=(0.0, 1.0), filled=(0.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class SensorSettings:
    """Noise of proprioception, uniform to either side; IsaacLab's but for joint velocities."""

    angular_velocity: float = 0.2
    gravity: float = 0.05
    joint_position: float = 0.01
    joint_velocity: float = 0.5
    """[rad/s]; IsaacLab's 1.5 would hide the velocity of the base, which is not told."""

    def __post_init__(self) -> None:
        check_between(self, angular_velocity=(0.0, 10.0), gravity=(0.0, 1.0))
        check_between(self, joint_position=(0.0, 1.0), joint_velocity=(0.0, 10.0))


@dataclass(frozen=True, kw_only=True)
class DriveSettings:
    """Numbers that turn actions into joint targets: a pose plus `scale` times the action."""

    height: float = 0.7
    """Height of the thighs' axes above the feet in that pose, by the length of the legs.

    0.30 m, joints at 0.8 and -1.6 rad, about legged_gym's. In the standing pose of jumping, which
    is lower, knees touch the ground under load.
    """
    scale: float = 0.25  # [rad]; legged_gym, IsaacLab
    kp: float = 35.0
    """[Nm/rad]; with IsaacLab's 25 for the Go2 a robot under 1.5 kg sits down on its rear knees."""
    kd: float = 0.8  # [Nm s/rad]; IsaacLab's 0.5 lets feet bounce here
    most: float = 10.0
    """Actions are cut off beyond this, to either side."""

    def __post_init__(self) -> None:
        check_between(
            self, height=(0.1, 0.99), scale=(SMALLEST, 10.0), kp=(0.0, 1e3), kd=(0.0, 1e2)
        )
        check_between(self, most=(SMALLEST, 1e3))


@dataclass(frozen=True, kw_only=True)
class WalkSettings:
    """Settings of the walking task: grounds, commands, rewards, errors, drives."""

    ground: GroundSettings = field(default_factory=GroundSettings)
    command: VelocityCommandSettings = field(default_factory=VelocityCommandSettings)
    reward: WalkRewardSettings = field(default_factory=WalkRewardSettings)
    scan: ScanErrorSettings = field(default_factory=ScanErrorSettings)
    sensors: SensorSettings = field(default_factory=SensorSettings)
    drives: DriveSettings = field(default_factory=DriveSettings)
    randomisation: RandomisationSettings = field(default_factory=RandomisationSettings)
    """Bodies, drives and pushes of jumping; its shift of heights and its torque are not used."""
    jump_start: JumpStartSettings = field(default_factory=JumpStartSettings)
    dialect: str = "isaaclab"
    """Dialect in which the policy reads heights, see `saltus.dialects`."""
    blind: bool = False
    """The policy is told that the ground is level at its standing height: the control."""
    time_limit_s: float = 20.0
    profile: str = "shipped"
    """Effects of the drives, see `saltus.effects.profile`."""

    def __post_init__(self) -> None:
        check_between(self, time_limit_s=(1.0, LARGEST))
        unknown = set(self.jump_start.families) - set(self.ground.shares)
        if self.jump_start.share > 0.0 and unknown:
            name, known = min(unknown), ", ".join(self.ground.shares)
            raise ConfigError(f"jump_start.families: no robot is on {name!r}; there are: {known}")


@dataclass(frozen=True, kw_only=True)
class WalkTrainSettings:
    """Settings of one training of a walking policy: what is learned, from what, and how."""

    robot: str
    """Name, or path of an MJCF or of a folder with a robot.toml."""
    robots: int = 4096
    """Robots of each process."""
    seed: int = 0
    """Seed of all random draws."""
    env: WalkSettings = field(default_factory=WalkSettings)
    learning: LearningSettings = field(
        default_factory=lambda: LearningSettings(
            first_std=0.8, std_range=(0.05, 2.0), first_entropy=0.005
        )
    )

    def __post_init__(self) -> None:
        check_between(self, robots=(1, MOST_ROBOTS), seed=(0, 2**32))
