"""Finds the numbers of the scripted planner: CMA-ES over batches of robots, each with parameters of its own.

Reference: N. Hansen, "The CMA Evolution Strategy: A Tutorial" (2016).
"""

import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np
from cmaes import CMA

from saltus import go1
from saltus.config import TerrainConfig
from saltus.policy.evaluation.rollout import Rollout, RolloutStep
from saltus.policy.scripted import ScriptedParameters, ScriptedPlanner
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain
from saltus.trial import Outcome, Trial
from saltus.wire.messages import Floats

SEARCH_WIDTH = 1.4  # of the courses [m]: the engine tests wide boxes against every link, and takes twice the time
FIRST_SEARCH_SEED = 1_000_000  # evaluations use small seeds: no trial is in both

Mapper = Callable[[Callable[[Floats], tuple[Floats, float]], Iterable[Floats]], Iterable[tuple[Floats, float]]]
"""`map`, or that of a pool of processes."""

BOUNDS: dict[str, tuple[float, float]] = {
    "stepping_frequency_hz": (1.6, 3.8),
    "velocity_x": (0.6, 2.5),
    "front_velocity_z": (-1.0, 2.0),
    "front_velocity_z_slope": (-2.0, 4.0),
    "rear_velocity_z": (-1.0, 2.0),
    "rear_velocity_z_slope": (-2.0, 4.0),
    "front_pitch_rate": (-6.0, 6.0),
    "front_pitch_rate_slope": (-12.0, 12.0),
    "rear_pitch_rate": (-6.0, 6.0),
    "rear_pitch_rate_slope": (-12.0, 12.0),
    "height_m": (0.24, 0.33),
    "height_gain": (0.0, 12.0),
    "ceiling_m": (0.26, 0.40),
    "ceiling_gain": (1.0, 15.0),
    "lever": (0.0, 3.0),
    "climb_gain": (0.0, 3.0),
    "pitch": (-0.3, 0.3),
    "pitch_per_slope": (-1.5, 0.0),
    "pitch_gain": (0.0, 12.0),
    "coupling": (0.0, 1.2),
    "front_landing_x": (-0.12, 0.12),
    "rear_landing_x": (-0.12, 0.12),
    "clearance_m": (0.02, 0.15),
    "landing_depth_m": (-0.02, 0.05),
    "lift_until": (0.1, 0.5),
    "lower_from": (0.5, 0.9),
    "edge_margin_m": (0.04, 0.2),
    "edge_cost": (0.0, 0.5),
    "height_trust": (0.0, 1.0),
}
"""Where each number is looked for: around what bounds of the action and the legs' reach allow."""


STAIRS = TerrainConfig(terrain="stairs", rise_m=0.06, run_m=0.25)
DEFAULT_COURSES = (
    TerrainConfig(terrain="flat"),
    STAIRS,
    STAIRS,
    TerrainConfig(terrain="stairs", rise_m=0.08, run_m=0.25),
    TerrainConfig(terrain="stepping_stones", gap_m=0.1),
    TerrainConfig(terrain="stepping_stones", gap_m=0.2),
    TerrainConfig(terrain="gap", gap_m=0.2),
    TerrainConfig(terrain="gap", gap_m=0.3),
    TerrainConfig(terrain="step", height_m=0.2),
)


START_X = 0.3  # trials begin nearer to the first edge than those that count [m]
STAND_STEPS = 20
POLICY_DT = go1.PHYSICS_DT * go1.POLICY_STEPS
# A candidate's score; what counts is that it does not fall, then how far it comes, then that it arrives.
WAY_SCORE, UPRIGHT_SCORE, SUCCESS_SCORE = 2.0, 1.0, 0.5
SPEED_ENOUGH = 1.1  # faster than that earns nothing: 0.8 m/s is wanted [m/s]
MISS_COST = 0.1  # for one foot that is always where it should not be
MEAN_SHARE = 0.7  # of the mean over courses in the score; the rest is the worst course


@dataclass(frozen=True, kw_only=True)
class SearchConfig:
    """What is searched, and how long."""

    courses: tuple[TerrainConfig, ...] = DEFAULT_COURSES
    """Every candidate runs each of them once in a generation."""
    generations: int = 100
    population: int = 14
    seed: int = 0
    sigma: float = 0.02
    """First step width, as a share of each parameter's range: a search begins with numbers that bound."""
    time_limit_s: float = 5.0
    """Of a trial: enough for every course but the flat one at 1.2 m/s."""


@dataclass(frozen=True, kw_only=True)
class Generation:
    """Progress of a search."""

    index: int
    best_score: float
    mean_score: float
    success: float
    """Share of trials that succeeded."""
    mean: ScriptedParameters
    """Centre of the distribution: the result, because it averages over the luck of single trials."""


def search(config: SearchConfig, start: ScriptedParameters, processes: int = 1) -> Iterator[Generation]:
    """Searches from `start` and yields after every generation.

    Args:
        config: What, and how long.
        start: First centre of the distribution.
        processes: How many share the candidates of a generation.
    """
    if processes == 1:
        yield from _search(config, start, 1, map)
        return
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from _search(config, start, processes, pool.map)


def _search(config: SearchConfig, start: ScriptedParameters, parts: int, each: Mapper) -> Iterator[Generation]:
    """The search with the candidates of a generation in `parts` batches, which `each` evaluates."""
    terrains = [replace(make_terrain(course), width=SEARCH_WIDTH) for course in config.courses]
    low, high = np.array(list(BOUNDS.values())).T
    values = np.array([float(asdict(start)[name]) for name in BOUNDS])
    unit = np.array([[0.0, 1.0]] * len(BOUNDS))
    mean = np.clip((values - low) / (high - low), 0.01, 0.99)
    optimiser = CMA(mean=mean, sigma=config.sigma, bounds=unit, seed=config.seed, population_size=config.population)
    for index in range(config.generations):
        candidates = [optimiser.ask() for _ in range(config.population)]
        vectors = low + np.array(candidates) * (high - low)
        first_seed = FIRST_SEARCH_SEED + (config.seed * 10_000 + index) * len(terrains)
        run = partial(evaluate, start=start, terrains=terrains, first_seed=first_seed, time_limit_s=config.time_limit_s)
        results = list(each(run, np.array_split(vectors, min(parts, len(vectors)))))
        scores = np.concatenate([result[0] for result in results])
        success = float(np.average([result[1] for result in results], weights=[len(r[0]) for r in results]))
        optimiser.tell([(candidate, -float(score)) for candidate, score in zip(candidates, scores, strict=True)])
        yield Generation(
            index=index,
            best_score=float(scores.max()),
            mean_score=float(scores.mean()),
            success=success,
            mean=_parameters(low + optimiser.mean * (high - low), start),
        )


def evaluate(
    vectors: Floats, start: ScriptedParameters, terrains: Sequence[Terrain], first_seed: int, time_limit_s: float
) -> tuple[Floats, float]:
    """Runs every candidate on every terrain, all with the same trials, in one batch.

    Args:
        vectors: Values of the parameters in the order of `BOUNDS`, shape (candidates, parameters).
        start: The other parameters.
        terrains: Courses.
        first_seed: Terrain i has the trial of this + i.
        time_limit_s: Of a trial.

    Returns:
        Scores, shape (candidates,), and the share of trials that succeeded.
    """
    courses, candidates = len(terrains), len(vectors)
    drawn = [Trial.draw(first_seed + i) for i in range(courses)]
    trials = [replace(trial, position_x=trial.position_x + START_X) for trial in drawn] * candidates
    planner = ScriptedPlanner(_parameters(np.repeat(vectors, courses, axis=0).T, start))
    rollout = Rollout(list(terrains) * candidates, trials, planner, time_limit_s=time_limit_s, stand_steps=STAND_STEPS)
    misses = np.zeros(rollout.count)
    steps = np.zeros(rollout.count)
    for step in rollout.run():
        misses += step.running * _missed_contacts(step)
        steps += step.running
    outcomes = [outcome for outcome in rollout.outcomes if outcome is not None]
    reach = SPEED_ENOUGH * (time_limit_s - STAND_STEPS * POLICY_DT)
    goals = np.array([min(terrain.finish_x - START_X, reach) for terrain in terrains] * candidates)
    scores = _scores(outcomes, goals) - MISS_COST * misses / steps
    per_candidate = scores.reshape(candidates, courses)
    mixed = MEAN_SHARE * per_candidate.mean(axis=1) + (1.0 - MEAN_SHARE) * per_candidate.min(axis=1)
    return mixed, float(np.mean([outcome.success for outcome in outcomes]))


def _scores(outcomes: Sequence[Outcome], goals: Floats) -> Floats:
    """Share of the way, and bonuses for those who did not fall and for those who arrived."""
    way = np.array([outcome.distance_m for outcome in outcomes]) / goals
    upright = np.array([outcome.cause in ("", "time_limit") for outcome in outcomes])
    success = np.array([outcome.success for outcome in outcomes])
    scores: Floats = WAY_SCORE * np.clip(way, 0.0, 1.0) + UPRIGHT_SCORE * upright + SUCCESS_SCORE * success
    return scores


def _missed_contacts(step: RolloutStep) -> Floats:
    """Number of feet that press on something in swing, or on nothing in stance. Shape (n,)."""
    pressing = step.truth.foot_force > 5.0  # [N]: above the noise of a foot that grazes the ground
    return np.asarray((pressing != step.states.leg_contact).sum(axis=-1), dtype=np.float64)


def _parameters(values: Floats, start: ScriptedParameters) -> ScriptedParameters:
    """Parameters from values in the order of `BOUNDS`, shape (parameters,) or (parameters, n)."""
    named = {name: value if np.ndim(value) else float(value) for name, value in zip(BOUNDS, values, strict=True)}
    return replace(start, **named)
