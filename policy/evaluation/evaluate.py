"""How well a planner does: many trials on one terrain, with what a seed draws."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from saltus.config import TerrainConfig, check_between
from saltus.controller.compensation import compensation_for
from saltus.effects.profile import Profile, load_profile
from saltus.errors import ConfigError
from saltus.grid import HeightGrid
from saltus.loop.heights import HeightsFactory, exact_heights, shifted_heights
from saltus.loop.loop import Loop, Moment
from saltus.loop.planner import Planner
from saltus.named_setup import named_setups
from saltus.policy.evaluation.trial_trace import FailureKind, TrialTrace, failure_of, traces_of
from saltus.policy.scripted import ScriptedPlanner
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.setup import Setup
from saltus.terrain.curriculum import is_drawn, make_terrain
from saltus.terrain.terrain import Terrain
from saltus.trial import TIME_LIMIT_S, Outcome, Trial
from saltus.workers import WorkerListener, in_order, tell_progress

BATCH = 25
"""Robots that a process runs at once: of 10 each costs twice the processor time, as numpy's calls
are shared."""
TELL_STEPS = 25  # policy steps between two reports of progress

MOST_TRIALS = 100_000
MAX_PLAN_DELAY_S = 0.1
"""After which the leg controller takes the planner for lost."""
MOST_FRICTION = 5.0
"""Five times that of rubber on dry concrete."""
MOST_PUSH_NS = 100.0
"""A robot of 12 kg would fly off at 8 m/s."""

PlannerFactory = Callable[[Robot, HeightGrid], Planner]
"""Makes the planner of robots of one kind that are given heights on a grid."""

HEIGHTS: dict[str, HeightsFactory] = {"true": shifted_heights, "true-exact": exact_heights}
"""Sources of heights by name: true ones with each trial's shift, and without."""


@dataclass(frozen=True, kw_only=True)
class EvaluationSettings:
    """Settings of an evaluation of a jumping policy: terrain, trials, heights, conditions."""

    robot: str
    """Name, or path of an MJCF or of a folder with a robot.toml."""
    grid: str
    """Grid of the heights that the planner is given: a name, or path of a TOML file."""
    camera: str = "ideal"
    """Camera of robots that predict their heights: a name, or a TOML file."""
    course: TerrainConfig
    trials: int = 20
    seed: int = 0
    """Seed of the first trial; the others have SEED + 1, SEED + 2, ..."""
    profile: str | Profile = "shipped"
    """Name, TOML file, or the effects themselves."""
    known: str | None = None
    """Name or TOML file of the profile of which the leg controller takes out torque gain and
    viscous friction."""
    friction: float | None = None
    """Friction of the ground in all trials, in place of what each draws."""
    push_ns: float = 0.0
    """Impulse of a push from the side in each trial, see `saltus.loop.loop` [Ns]."""
    time_limit_s: float = TIME_LIMIT_S
    plan_delay_s: float = 0.0
    """From a state to its plan being obeyed: what the computer of a real robot takes."""

    def __post_init__(self) -> None:
        check_between(
            self,
            trials=(1, MOST_TRIALS),
            seed=(0, 2**32),
            friction=(0.01, MOST_FRICTION),
            push_ns=(0.0, MOST_PUSH_NS),
        )
        if not 0.0 <= self.plan_delay_s <= MAX_PLAN_DELAY_S:
            raise ConfigError(
                f"plan_delay_s = {self.plan_delay_s:g}: it must be from 0 to {MAX_PLAN_DELAY_S:g}"
            )
        # What is wrong with terrain or profile is said before anything runs
        make_terrain(self.course)
        robot = load_robot(self.robot)
        if isinstance(self.profile, str):
            load_profile(self.profile, robot)
        compensation_for(self.known, robot)

    def setups(self, seeds: Sequence[int]) -> list[Setup]:
        """A robot for each seed."""
        terrains, trials = courses_of(self.course, seeds), [self.trial(seed) for seed in seeds]
        return named_setups(self.robot, self.grid, self.camera, self.profile, terrains, trials)

    def trial(self, seed: int) -> Trial:
        """The trial of a seed."""
        trial = Trial.draw(seed)
        return trial if self.friction is None else replace(trial, friction=self.friction)


def success_interval(successes: int, trials: int) -> tuple[float, float]:
    """The 95 % interval of the share of successes (Wilson's)."""
    from scipy.stats import binomtest  # loads as long as all else

    found = binomtest(successes, trials).proportion_ci(method="wilson")
    return float(found.low), float(found.high)


@dataclass(frozen=True, kw_only=True, eq=False)
class TrialResult:
    """How one trial of a jumping policy went."""

    outcome: Outcome
    failure: FailureKind
    """Why it failed; empty after a success."""
    trace: TrialTrace


@dataclass(frozen=True, kw_only=True, eq=False)
class EvaluationResult:
    """Trials of a jumping policy in the order of their seeds, and their statistics."""

    seeds: tuple[int, ...]
    trials: tuple[TrialResult, ...]

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        """Outcomes of each trial."""
        return tuple(trial.outcome for trial in self.trials)

    @property
    def successes(self) -> int:
        """Number of trials that succeeded."""
        return sum(outcome.success for outcome in self.outcomes)

    @property
    def success_interval(self) -> tuple[float, float]:
        """See `success_interval`."""
        return success_interval(self.successes, len(self.trials))

    @property
    def failures(self) -> dict[str, int]:
        """How often each cause of failure occurred."""
        return dict(Counter(trial.failure for trial in self.trials if trial.failure))

    @property
    def mean_speed_mps(self) -> float:
        """Horizontal speed over successful trials; NaN where there are none."""
        return _mean([outcome.mean_speed_mps for outcome in self.outcomes if outcome.success])

    @property
    def median_time_s(self) -> float:
        """Time over successful trials; NaN where there are none."""
        times = [outcome.time_s for outcome in self.outcomes if outcome.success]
        return float(np.median(times)) if times else math.nan


def evaluate_policy(
    evaluation: EvaluationSettings,
    heights: HeightsFactory = shifted_heights,
    planner: PlannerFactory = ScriptedPlanner,
    processes: int | None = None,
    listener: WorkerListener | None = None,
) -> Iterator[dict[int, TrialResult]]:
    """Runs the trials and yields batches of results by seed, in their order.

    `heights` and `planner` make the source of heights and the planner of robots; both must be
    picklable where `processes` (one for each core by default) is not 1. The listener is told of
    progress, in trials.
    """
    run = partial(run_batch, evaluation, heights, planner)
    batches = _batches(range(evaluation.seed, evaluation.seed + evaluation.trials), BATCH)
    yield from in_order(run, batches, processes, listener)


def merge_batches(batches: Iterable[dict[int, TrialResult]]) -> EvaluationResult:
    """Puts the batches of `evaluate_policy` together."""
    results = {seed: result for batch in batches for seed, result in batch.items()}
    seeds = tuple(sorted(results))
    return EvaluationResult(seeds=seeds, trials=tuple(results[seed] for seed in seeds))


def run_batch(
    evaluation: EvaluationSettings,
    heights: HeightsFactory,
    planner: PlannerFactory,
    seeds: Sequence[int],
) -> dict[int, TrialResult]:
    """Runs the trials of some seeds in one batch."""
    setups = evaluation.setups(seeds)
    robot, terrains = setups[0].robot, [setup.terrain for setup in setups]
    loop = Loop(
        setups,
        planner(robot, setups[0].grid),
        compensation=compensation_for(evaluation.known, robot),
        heights=heights(setups),
        time_limit_s=evaluation.time_limit_s,
        plan_delay_s=evaluation.plan_delay_s,
        push_ns=evaluation.push_ns,
    )
    traces = traces_of(list(_telling(loop, terrains)))
    ended = zip(seeds, loop.outcomes, traces, terrains, strict=True)
    return {
        seed: TrialResult(
            outcome=outcome, failure=failure_of(robot, outcome, trace, terrain), trace=trace
        )
        for seed, outcome, trace, terrain in ended
        if outcome is not None
    }


def _telling(loop: Loop, terrains: Sequence[Terrain]) -> Iterator[Moment]:
    """The moments of a loop; reports progress in trials, of running ones their share of the way."""
    finish_x, done = np.array([terrain.finish_x for terrain in terrains]), np.zeros(loop.count)
    for index, step in enumerate(loop.run()):
        yield step
        if index % TELL_STEPS == 0:
            way = np.where(step.running, step.truth.position_base_in_world[:, 0] / finish_x, 1.0)
            before, done = done, np.maximum(done, np.clip(way, 0.0, 1.0))
            tell_progress(float((done - before).sum()))
    tell_progress(float((1.0 - done).sum()))


def courses_of(course: TerrainConfig, seeds: Sequence[int]) -> list[Terrain]:
    """The terrain of each trial: one for all, unless something of it is drawn."""
    if not is_drawn(course):
        return [make_terrain(course)] * len(seeds)
    return [make_terrain(replace(course, layout_seed=int(seed))) for seed in seeds]


def _batches(seeds: Sequence[int], size: int) -> list[list[int]]:
    count = math.ceil(len(seeds) / size)
    return [list(part) for part in np.array_split(np.asarray(seeds), count)]


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else math.nan
