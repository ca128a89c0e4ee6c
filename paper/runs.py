"""Trials of the deployed system in one process: what rows about motion are measured on.

Robots see as deployed: the shipped predictor on late images of a D435i with its errors. All of it
is simulation.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from paper.imitation import ImitatedPlans, ImitationNetwork, PassOn
from paper.training import CAMERA
from saltus.arrays import Floats
from saltus.depth import MILLIMETRE, NOTHING
from saltus.effects.profile import SHIPPED, Profile
from saltus.grid import LINE
from saltus.heightmap.data.predicted import PredictedHeights, PredictedHeightsFactory
from saltus.loop.heights import HeightsFactory, HeightSource, exact_heights
from saltus.loop.loop import Loop, Moment
from saltus.loop.planner import Planner
from saltus.named_setup import named_setups
from saltus.policy.evaluation.evaluate import BATCH
from saltus.policy.evaluation.trial_trace import FailureKind, TrialTrace, failure_of, traces_of
from saltus.policy.planner import make_planner
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.terrain.terrain import Terrain
from saltus.trial import TIME_LIMIT_S, Outcome, Trial
from saltus.workers import in_order

FIRST_SEED = 130_000
"""First seed of trials that no other figure of Saltus stands on."""
PAIRS = {"front": slice(0, 2), "rear": slice(2, 4)}
"""Legs that stand together when a robot bounds."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Setting that robots of one kind of trial meet."""

    terrain: Terrain
    feedback: bool = True
    """True where legs that stand track velocities by feedback; without, feed-forward is left
    alone."""
    starts_x: tuple[float, ...] = ()
    """Where each robot starts [m]; by default where its trial says."""
    true_heights: bool = False
    """The planner is given the terrain as it is, and sees nothing."""
    policy: Path | None = None
    """ONNX file; by default the shipped policy."""
    predictor: Path | None = None
    """ONNX file; by default the shipped predictor."""
    imitator: Path | None = None
    """ONNX file of what plans from images, in the place of policy and predictor."""
    profile: str | Profile = SHIPPED


@dataclass(frozen=True, kw_only=True)
class Effort:
    """How much is run for a row."""

    trials: int = 100
    first_seed: int = FIRST_SEED
    time_limit_s: float = TIME_LIMIT_S
    """Time limit of each trial."""
    processes: int | None = None
    """How many run at once; by default one for each core."""
    say: Callable[[float], None] | None = field(default=None, compare=False)
    """Told of each trial that is over."""

    @property
    def seeds(self) -> range:
        """Seeds of the trials."""
        return range(self.first_seed, self.first_seed + self.trials)


@dataclass(frozen=True, kw_only=True, eq=False)
class Landing:
    """A pair of feet that came down."""

    row: int
    """Row of the trace."""
    time_s: float
    x: float
    """Mean of the pair [m]."""
    z: float
    """Height of their centres [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ran:
    """A trial that is over, one row each 10 ms; t rows."""

    seed: int
    terrain: Terrain
    outcome: Outcome
    failure: FailureKind
    trace: TrialTrace
    reference: Floats
    """Velocities that were planned: ahead and up [m/s], pitch rate (nose down positive) [rad/s],
    shape (t, 3)."""
    velocity: Floats
    """The same as they were, shape (t, 3)."""
    frequency_hz: Floats
    """Stepping frequency that was planned, shape (t,)."""

    @cached_property
    def going(self) -> NDArray[np.bool_]:
        """The robot has begun to bound, shape (t,)."""
        return np.asarray(np.cumsum(~self.trace.stance.all(axis=-1)) > 0)

    def landings(self, pair: str) -> list[Landing]:
        """Place where a pair of feet came to bear first in each of its stances,
        but for the one that it starts in.
        """
        legs = PAIRS[pair]
        stands = np.asarray(self.trace.stance[:, legs].any(axis=-1))
        begins = np.flatnonzero(stands[1:] & ~stands[:-1]) + 1
        found = []
        for begin, end in zip(begins, np.append(begins, len(stands))[1:], strict=True):
            bears = np.asarray(self.trace.loaded[begin:end, legs].any(axis=-1)) & stands[begin:end]
            if bears.any():
                row = int(begin + np.argmax(bears))
                x, _, z = self.trace.foot[row, legs].mean(axis=0)
                found.append(
                    Landing(row=row, time_s=float(self.trace.time_s[row]), x=float(x), z=float(z))
                )
        return found

    @property
    def jumps(self) -> int:
        """Landings of the front feet beyond the first edge,
        up to the first one beyond the last edge.
        """
        edges = self.terrain.edges_x
        behind = [landing.x for landing in self.landings("front") if landing.x >= edges[0]]
        over = next((i for i, x in enumerate(behind) if x >= edges[-1]), len(behind) - 1)
        return over + 1

    @property
    def edges_passed(self) -> int:
        """Number of edges of the course that the trunk's centre came across:
        steps of a staircase before a failure.
        """
        return int((self.terrain.edges_x <= self.trace.base[:, 0].max()).sum())

    def time_at(self, x: float) -> float:
        """When the trunk's centre passed a place first [s]; NaN where it never did."""
        passed = self.trace.base[:, 0] >= x
        return float(self.trace.time_s[np.argmax(passed)]) if passed.any() else float("nan")


def ran(settings: Sequence[Setting], effort: Effort) -> list[list[Ran]]:
    """The trials of each setting, in the order of their seeds."""
    tasks = []
    for place, setting in enumerate(settings):
        seeds = (
            list(effort.seeds)
            if not setting.starts_x
            else [effort.first_seed] * len(setting.starts_x)
        )
        starts = setting.starts_x or (None,) * len(seeds)
        numbered = list(zip(seeds, starts, strict=True))
        tasks += [
            (place, (setting, numbered[i : i + BATCH])) for i in range(0, len(numbered), BATCH)
        ]
    results: list[list[Ran]] = [[] for _ in settings]
    batches = in_order(
        partial(_run, effort.time_limit_s), [task for _, task in tasks], effort.processes
    )
    for (place, _), batch in zip(tasks, batches, strict=True):
        results[place] += batch
        if effort.say is not None:
            effort.say(len(batch))
    return results


def watched(setting: Setting, effort: Effort) -> tuple[Ran, list[tuple[float, Floats]]]:
    """The first trial with what its camera saw:
    time [s] and depth [m], shape (48, 16), of each image.
    """
    images: list[tuple[float, Floats]] = []

    def look(moment: Moment, source: HeightSource) -> None:
        given = source.given if isinstance(source, PredictedHeights) else None
        if given is not None:
            depth = np.where(given.depth[0] == NOTHING, np.inf, MILLIMETRE * given.depth[0])
            images.append((float(moment.states.time_s), depth))

    (run,) = _run(effort.time_limit_s, (setting, [(effort.first_seed, None)]), look)
    return run, images


def _run(
    time_limit_s: float,
    task: tuple[Setting, Sequence[tuple[int, float | None]]],
    look: Callable[[Moment, HeightSource], object] | None = None,
) -> list[Ran]:
    """Robots of one setting, by seed and start."""
    setting, numbered = task
    robot = load_robot(DEFAULT_ROBOT)
    driven = (
        robot if setting.feedback else replace(robot, gains=replace(robot.gains, stance_kd=0.0))
    )
    trials = [
        trial if start is None else replace(trial, position_x=start)
        for trial, start in ((Trial.draw(seed), start) for seed, start in numbered)
    ]
    setups = named_setups(
        driven, LINE, CAMERA, setting.profile, [setting.terrain] * len(trials), trials
    )
    planner: Planner
    source: HeightSource
    if setting.imitator is None:
        planner = make_planner("learned", robot, LINE, setting.policy)
        see: HeightsFactory = PredictedHeightsFactory(model=setting.predictor)
        source = exact_heights(setups) if setting.true_heights else see(setups)
    else:
        network = ImitationNetwork(setting.imitator)
        planner, source = PassOn(network.bounds), ImitatedPlans(network, setups)
    loop = Loop(setups, planner, heights=source, time_limit_s=time_limit_s)
    steps = []
    for step in loop.run():
        steps.append(step)
        if look is not None:
            look(step, source)
    reference = np.array([_planned(step) for step in steps])
    velocity = np.array([_moved(step) for step in steps])
    frequency = np.array([step.plan.stepping_frequency_hz for step in steps])
    made = []
    for i, (trace, outcome) in enumerate(zip(traces_of(steps), loop.outcomes, strict=True)):
        if outcome is not None:
            rows = len(trace.pose)
            made.append(
                Ran(
                    seed=numbered[i][0],
                    terrain=setting.terrain,
                    outcome=outcome,
                    failure=failure_of(robot, outcome, trace, setting.terrain),
                    trace=trace,
                    reference=reference[:rows, i],
                    velocity=velocity[:rows, i],
                    frequency_hz=frequency[:rows, i],
                )
            )
    return made


def _planned(step: Moment) -> Floats:
    """Shape (n, 3)."""
    plan = step.plan
    return np.stack([plan.velocity_x, plan.velocity_z, plan.pitch_rate], axis=-1)


def _moved(step: Moment) -> Floats:
    """Shape (n, 3); courses lead along x."""
    linear, angular = step.truth.velocity_base_in_world, step.truth.angular_velocity_base
    return np.stack([linear[:, 0], linear[:, 2], angular[:, 1]], axis=-1)
