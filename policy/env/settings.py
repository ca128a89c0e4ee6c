"""Settings of a training: one dataclass that is the TOML,
the flags, and what a checkpoint holds.
"""

from dataclasses import dataclass, field
from typing import Annotated

import tyro

from saltus.config import check_between
from saltus.effects.profile import Profile
from saltus.errors import ConfigError
from saltus.policy.bounds import ActionBounds
from saltus.policy.env.curriculum import CurriculumSettings
from saltus.policy.env.jump_rewards import JumpRewardSettings
from saltus.policy.env.randomisation import RandomisationSettings
from saltus.policy.policy_features import check_past_steps

MOST_ROBOTS = 2**18
"""16 times what one GPU trains."""
SMALLEST, LARGEST = 1e-9, 1e6
"""Stand-ins for 0 and for no end, where a number must be more than 0 or have an end."""


@dataclass(frozen=True, kw_only=True)
class EpisodeSettings:
    """When an episode of training ends: time limit, falls, and leaving the course."""

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

    def __post_init__(self) -> None:
        above = (SMALLEST, LARGEST)
        check_between(
            self,
            time_limit_s=above,
            lowest_base_m=above,
            sunk_m=above,
            astray_m=above,
            astray_rad=above,
        )


@dataclass(frozen=True, kw_only=True)
class JumpEnvSettings:
    """Settings of the jumping task: terrains, rewards, randomisation, episodes."""

    bounds: ActionBounds = field(default_factory=ActionBounds)
    reward: JumpRewardSettings = field(default_factory=JumpRewardSettings)
    randomisation: RandomisationSettings = field(default_factory=RandomisationSettings)
    curriculum: CurriculumSettings = field(default_factory=CurriculumSettings)
    episode: EpisodeSettings = field(default_factory=EpisodeSettings)
    past_steps: Annotated[tuple[int, ...], tyro.conf.arg(help_behavior_hint="(default: none)")] = ()
    """Instants that the policy recalls, in steps of 10 ms before the present one, ascending."""
    profile: Annotated[str, tyro.conf.arg(prefix_name=False)] = "shipped"
    """Effects of the drives: shipped (those of the robot), ideal, one of your own, or a TOML
    file."""

    def contact_dimensions(self, profile: Profile) -> int:
        """Number of directions that contacts need for the effects
        of `profile` and for what is drawn beyond them.
        """
        return max(
            profile.body_chain.contact_dimensions, self.randomisation.wide.contact_dimensions
        )

    def __post_init__(self) -> None:
        check_past_steps(self.past_steps)


@dataclass(frozen=True, kw_only=True)
class LearningSettings:
    """Settings of networks and of the learning method PPO; those of the original where nothing else
    is said.
    """

    hidden: tuple[int, ...] = (512, 256, 128)
    """Widths of actor and critic, ELU between."""
    horizon: int = 24
    """Steps of each robot in an iteration."""
    epochs: int = 5
    """Times that an iteration's experience is learned from."""
    minibatches: int = 4
    """Parts of the experience, one for each step of the optimiser."""
    gamma: float = 0.99
    """Discount of a step."""
    lam: float = 0.95
    """Lambda of the generalised advantage estimate."""
    clip: float = 0.2
    """Clip of the ratio of probabilities."""
    learning_rate: float = 1e-3
    """At first; then adapted to `desired_kl`."""
    desired_kl: float = 0.01
    """KL divergence between policies before and after an update that the learning rate is adapted
    to, at first."""
    last_kl: float = 0.01
    """`desired_kl` from iteration `entropy_iterations` on; before, it falls geometrically."""
    max_grad_norm: float = 1.0
    """Longer gradients are shortened."""
    first_std: float = 0.4
    """First standard deviation of the action, in units of half its range; original 0.5, for
    narrower ranges."""
    first_lift_std: float = 0.25
    """First standard deviation of the feet's lift, whose range is wide for the sake of the highest
    steps: 0.15 m."""
    std_range: tuple[float, float] = (0.05, 1.0)
    """Lowest and highest standard deviation."""
    first_entropy: float = 0.01
    """Weight of the entropy at the first iteration; original, where it stays,
    and with it a standard deviation of half the range."""
    last_entropy: float = 0.001
    """Weight from iteration `entropy_iterations` on; before, it falls geometrically."""
    entropy_iterations: int = 1500
    """Iterations until `last_entropy` and `last_kl`."""
    critic_iterations: int = 0
    """First iterations, in which only the critic learns."""

    def __post_init__(self) -> None:
        count, above, share = (1, 10**6), (SMALLEST, LARGEST), (0.0, 1.0)
        check_between(
            self,
            hidden=count,
            horizon=count,
            epochs=count,
            minibatches=count,
            entropy_iterations=count,
            critic_iterations=(0, count[1]),
        )
        check_between(
            self,
            gamma=share,
            lam=share,
            clip=share,
            learning_rate=above,
            desired_kl=above,
            last_kl=above,
        )
        check_between(
            self, max_grad_norm=above, first_std=above, first_lift_std=above, std_range=above
        )
        check_between(self, first_entropy=above, last_entropy=above)
        if not self.hidden:
            raise ConfigError("hidden = (): a network needs a hidden layer")
        if self.std_range[0] > self.std_range[1]:
            raise ConfigError(f"std_range = {self.std_range}: the lowest comes first")


@dataclass(frozen=True, kw_only=True)
class JumpTrainSettings:
    """Settings of one training of the jumping policy: what is learned, from what, and how."""

    robot: str
    """Name, or path of an MJCF or of a folder with a robot.toml."""
    grid: str
    """Grid of the heights that the policy is given: a name, or path of a TOML file
    (`saltus.grid`)."""
    robots: int = 4096
    """Robots of each process."""
    seed: int = 0
    """Seed of all random draws."""
    env: JumpEnvSettings = field(default_factory=JumpEnvSettings)
    learning: LearningSettings = field(default_factory=LearningSettings)

    def __post_init__(self) -> None:
        check_between(self, robots=(1, MOST_ROBOTS), seed=(0, 2**32))
        if self.robots * self.learning.horizon < self.learning.minibatches:
            raise ConfigError(
                f"robots = {self.robots}: with a horizon of {self.learning.horizon} steps they are "
                "too few for "
                f"{self.learning.minibatches} minibatches"
            )


def for_gpu(robot: str, grid: str) -> JumpTrainSettings:
    """Settings for one GPU: the paper's terrains."""
    return JumpTrainSettings(robot=robot, grid=grid, robots=16384)


def for_cpu(robot: str, grid: str) -> JumpTrainSettings:
    """Settings for two cores: to bound on flat ground within minutes,
    with networks a twelfth of the size.
    """
    flat = CurriculumSettings(flat=1.0, stairs=0.0, stepping_stones=0.0, step=0.0, gap=0.0)
    return JumpTrainSettings(
        robot=robot,
        grid=grid,
        robots=256,
        env=JumpEnvSettings(curriculum=flat),
        learning=LearningSettings(hidden=(128, 128, 64), epochs=4),
    )
