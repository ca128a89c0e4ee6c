"""Configuration of a training run."""

from dataclasses import dataclass, field

from saltus.policy.bounds import ActionBounds
from saltus.policy.env.curriculum import CurriculumConfig
from saltus.policy.env.randomisation import RandomisationConfig
from saltus.policy.env.rewards import RewardConfig


@dataclass(frozen=True, kw_only=True)
class EpisodeConfig:
    """When an episode is over."""

    time_limit_s: float = 10.0
    """Two and a half times what the paper's robot takes for its stairs."""
    lowest_base_m: float = 0.10
    """Above the terrain under it; original."""
    sunk_m: float = 0.12
    """Below the ground on which the robot starts: it is in a trench."""
    astray_m: float = 1.5
    """Sideways from the middle of the course, which is 4 m wide."""
    astray_rad: float = 1.0
    """Yaw from the heading."""


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """Everything that shapes the task."""

    bounds: ActionBounds = field(default_factory=ActionBounds)
    reward: RewardConfig = field(default_factory=RewardConfig)
    randomisation: RandomisationConfig = field(default_factory=RandomisationConfig)
    curriculum: CurriculumConfig = field(default_factory=CurriculumConfig)
    episode: EpisodeConfig = field(default_factory=EpisodeConfig)
    profile: str = "go1"
    """Effects of the drives: ideal, go1, one of your own, or a TOML file."""


@dataclass(frozen=True, kw_only=True)
class LearningConfig:
    """Networks and PPO; original where nothing else is said."""

    hidden: tuple[int, ...] = (512, 256, 128)
    """Widths of actor and critic, ELU between."""
    horizon: int = 24
    """Steps of each robot in an iteration."""
    epochs: int = 5
    minibatches: int = 4
    gamma: float = 0.99
    lam: float = 0.95
    clip: float = 0.2
    learning_rate: float = 1e-3
    """At first; then adapted to `desired_kl`."""
    desired_kl: float = 0.01
    max_grad_norm: float = 1.0
    first_std: float = 0.4
    """Of the action, in units of half its range; original 0.5, for narrower ranges."""
    first_lift_std: float = 0.25
    """The same of the feet's lift, whose range is wide for the sake of the highest steps: 0.15 m."""
    std_range: tuple[float, float] = (0.05, 1.0)
    first_entropy: float = 0.01
    """Weight of the entropy at the first iteration; original, where it stays, and with it a standard deviation of half
    the range."""
    last_entropy: float = 0.001
    """The same from iteration `entropy_iterations` on; between them it falls geometrically."""
    entropy_iterations: int = 1500


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """One training run."""

    robots: int = 4096
    """Of each process; original."""
    seed: int = 0
    env: EnvConfig = field(default_factory=EnvConfig)
    learning: LearningConfig = field(default_factory=LearningConfig)


def for_gpu() -> TrainConfig:
    """What one GPU trains: all terrains."""
    return TrainConfig(robots=16384)


def for_cpu() -> TrainConfig:
    """What two cores learn within minutes: to bound on flat ground, with networks a twelfth of the size."""
    flat = CurriculumConfig(flat=1.0, stairs=0.0, stepping_stones=0.0, step=0.0, gap=0.0)
    return TrainConfig(
        robots=256, env=EnvConfig(curriculum=flat), learning=LearningConfig(hidden=(128, 128, 64), epochs=4)
    )
