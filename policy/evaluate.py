"""How well a planner does: many trials on one terrain, with what a seed draws."""

import math
import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial

import numpy as np

from policy.planner import Planner
from policy.rollout import HeightsFactory, Rollout, exact_heights, shifted_heights
from policy.scripted import ScriptedPlanner
from saltus.config import TerrainConfig
from saltus.effects.profile import load_profile
from saltus.errors import ConfigError
from saltus.terrain.curriculum import make_terrain
from saltus.trial import TIME_LIMIT_S, Outcome, Trial

BATCH = 10  # robots a process runs at once: enough that numpy's overhead is shared, few enough to show progress

HEIGHTS: dict[str, HeightsFactory] = {"true": shifted_heights, "true-exact": exact_heights}
"""Sources of heights by name: true ones with each trial's shift, and without."""


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """What is evaluated."""

    course: TerrainConfig
    trials: int = 20
    first_seed: int = 0
    profile: str = "go1"
    time_limit_s: float = TIME_LIMIT_S

    def __post_init__(self) -> None:
        if self.trials < 1:
            raise ConfigError(f"trials = {self.trials}: it must be at least 1")
        if self.first_seed < 0:
            raise ConfigError(f"first_seed = {self.first_seed}: seeds are not negative")


@dataclass(frozen=True, kw_only=True)
class EvaluationResult:
    """The trials in the order of their seeds, and what they amount to."""

    seeds: tuple[int, ...]
    outcomes: tuple[Outcome, ...]

    @property
    def successes(self) -> int:
        """Number of trials that succeeded."""
        return sum(outcome.success for outcome in self.outcomes)

    @property
    def causes(self) -> dict[str, int]:
        """How often each cause of failure occurred."""
        return dict(Counter(outcome.cause for outcome in self.outcomes if not outcome.success))

    @property
    def mean_speed_mps(self) -> float:
        """Horizontal speed over successful trials; NaN where there are none."""
        return _mean([outcome.mean_speed_mps for outcome in self.outcomes if outcome.success])

    @property
    def mean_time_s(self) -> float:
        """Time over successful trials; NaN where there are none."""
        return _mean([outcome.time_s for outcome in self.outcomes if outcome.success])


def evaluate(
    evaluation: Evaluation,
    heights: HeightsFactory = shifted_heights,
    planner: Callable[[], Planner] = ScriptedPlanner,
    processes: int | None = None,
) -> Iterator[dict[int, Outcome]]:
    """Runs the trials and yields, as they end, batches of outcomes by seed.

    Args:
        evaluation: What to run.
        heights: Makes the planner's source of heights; must be picklable where `processes` is not 1.
        planner: Makes the planner; must be picklable where `processes` is not 1.
        processes: How many run at once; by default one for each core.
    """
    run = partial(run_batch, evaluation, heights, planner)
    batches = _batches(range(evaluation.first_seed, evaluation.first_seed + evaluation.trials), BATCH)
    workers = min(processes or multiprocessing.cpu_count(), len(batches))
    if workers == 1:
        yield from map(run, batches)
        return
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for future in as_completed([pool.submit(run, batch) for batch in batches]):
            yield future.result()


def collect(batches: Iterator[dict[int, Outcome]]) -> EvaluationResult:
    """Puts the batches of `evaluate` together."""
    outcomes = {seed: outcome for batch in batches for seed, outcome in batch.items()}
    seeds = tuple(sorted(outcomes))
    return EvaluationResult(seeds=seeds, outcomes=tuple(outcomes[seed] for seed in seeds))


def run_batch(
    evaluation: Evaluation, heights: HeightsFactory, planner: Callable[[], Planner], seeds: Sequence[int]
) -> dict[int, Outcome]:
    """Runs the trials of some seeds in one batch."""
    terrain = make_terrain(evaluation.course)
    rollout = Rollout(
        [terrain] * len(seeds),
        [Trial.draw(seed) for seed in seeds],
        planner(),
        profile=load_profile(evaluation.profile),
        heights=heights,
        time_limit_s=evaluation.time_limit_s,
    )
    for _ in rollout.run():
        pass
    ended = zip(seeds, rollout.outcomes, strict=True)
    return {seed: outcome for seed, outcome in ended if outcome is not None}


def _batches(seeds: Sequence[int], size: int) -> list[list[int]]:
    count = math.ceil(len(seeds) / size)
    return [list(part) for part in np.array_split(np.asarray(seeds), count)]


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else math.nan
