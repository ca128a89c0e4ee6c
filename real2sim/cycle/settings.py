"""Settings of a cycle: the same dataclass is its TOML file
and the flags of `saltus real2sim cycle`.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from saltus.config import check_between
from saltus.effects.profile import SHIPPED
from saltus.errors import ConfigError
from saltus.flags import flag_help
from saltus.heightmap.settings import FURTHER_RATE, MANY, ClosedLoop, PredictorTraining

EXPERIMENTS = ("joint_tour", "squat", "heave_and_pitch", "height_step")
"""Drives on a stand, body, and the camera's time and place: each kind of sensor has its
experiment."""


@dataclass(frozen=True, kw_only=True)
class CycleSettings:
    """Settings of a cycle (log, find, train, measure) of the robot of the shipped models.

    All but the numbers of trials stay as the folder was begun.

    Raises:
        ConfigError: a number that cannot be, or an experiment that there is not.
    """

    hidden: Annotated[Path | None, flag_help("PATH", "none: only logs are known of the robot")] = (
        None
    )
    """Profile (TOML) that stands for the real robot: it is run and measured, and never shown to the
    search."""
    profile: str = SHIPPED
    """Profile that is known of the robot: shipped, ideal, one of your own, or a TOML file. What is
    found is added to it."""
    logs: Annotated[
        tuple[Path, ...],
        flag_help("[PATH [PATH ...]]", "none: experiments are run on the hidden robot"),
    ] = ()
    """Run logs of your own, or runs of Saltus, in place of experiments."""
    experiments: tuple[str, ...] = EXPERIMENTS
    """Experiments of the hidden robot for its logs, see saltus real2sim experiments."""
    seed: int = 0
    """Seed of the sensors' noise, data and training; the first trial has it, too."""
    batches: int = 8
    """Batches of the predictor's data where they are made on processors, each of `loop.robots`
    robots."""
    episodes: int = 8192
    """Episodes of the predictor's data where they are made on a GPU; falls make more of them."""
    policy_minutes: float = 10.0
    """Time of the policy's training, where there is a GPU."""
    choice_trials: int = 100
    """On each course, of robots with the profile that was found, with the trained models,
    the shipped ones, and one of each: what does best is taken. Fewer do not tell 92 % from 98 %."""
    trials: int = 20
    """On each course, with the models before and after.

    More may be asked for later, and add to those there are.
    """
    loop: ClosedLoop
    """How training data are collected. Its camera takes the images of the measurement, too."""
    predictor: PredictorTraining = field(
        default_factory=lambda: PredictorTraining(learning_rate=FURTHER_RATE)
    )
    """The predictor's training, from the shipped checkpoint.

    On a GPU it bears 12,000 updates of 128 windows.
    """

    def __post_init__(self) -> None:
        check_between(
            self, seed=(0, 2**32), batches=(1, MANY), episodes=(1, MANY), trials=(1, MANY)
        )
        check_between(self, choice_trials=(1, MANY))
        if not 0.0 < self.policy_minutes < MANY:
            raise ConfigError(
                f"policy_minutes = {self.policy_minutes:g}: it must be more than 0, and have an end"
            )
        if not self.experiments:
            raise ConfigError("experiments = (): name at least one")
        # Here, so that commands load without it
        from saltus.real2sim.experiments.menu import (
            experiment_named,
        )

        for name in self.experiments:
            experiment_named(name)
