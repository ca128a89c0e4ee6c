"""Trials of a walking policy as it is deployed: crossings of ten metres, drills and errands.

Everything but the bus is that of a run: planner, control loop, sensors, drives and body as each
trial draws them, and heights that are true or those of the scan's service. The operator sees where
the robot is, as somebody with a gamepad does.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from saltus.config import WALKING_CAMERA
from saltus.controller.tick import CompiledTickLaw
from saltus.drive.wish import Wish
from saltus.errors import ConfigError
from saltus.named_setup import named_setups
from saltus.policy.evaluation.evaluate import success_interval
from saltus.policy.evaluation.walking_conditions import WalkConditions
from saltus.policy.evaluation.walking_drill import DrillResult, drill_row, run_drill
from saltus.policy.evaluation.walking_errands import (
    ErrandResult,
    errand_row,
    run_line,
    run_route,
    run_stop,
)
from saltus.policy.evaluation.walking_grounds import (
    FINISH_X,
    WIDTH_M,
    drill_ground,
    make_walk_ground,
)
from saltus.policy.evaluation.walking_judge import (
    BEGINS_S,
    SLACK,
    WalkEndCause,
    WalkRun,
    drawn_speed,
    failure_reason,
    median_or_none,
    walk_along_x,
)
from saltus.policy.evaluation.walking_jumps import JumpAngles, jumped_ground, run_jump
from saltus.policy.evaluation.walking_routes import make_route
from saltus.policy.evaluation.walks import (
    RobotHeightSourceFactory,
    WalkOperator,
    WalkStep,
    walk_steps,
)
from saltus.policy.joints.policy import JointPolicy
from saltus.policy.joints.walker import Walker
from saltus.policy.mover import FeetLines, Jumper, Mover
from saltus.policy.planner import jumping_grid, jumping_planner
from saltus.setup import Setup
from saltus.sim.plant_state import PlantState
from saltus.terrain.terrain import Terrain
from saltus.trial import Trial
from saltus.workers import WorkerListener, in_order, tell_progress

SEEDS_AT_A_TIME = 5

WalkTrialKind = Literal["cross", "drill", "route", "stop", "line", "jump", "jump_stop"]


@dataclass(frozen=True, kw_only=True)
class WalkTrials:
    """Settings of the trials of one walking policy."""

    robot: str
    grid: str
    model: Path
    """The policy: an ONNX file, or a TOML file about somebody else's."""
    camera: str = WALKING_CAMERA
    profile: str = "shipped"
    conditions: WalkConditions = field(default_factory=WalkConditions)
    angles: JumpAngles = field(default_factory=JumpAngles)

    def setup(self, terrain: Terrain, seed: int) -> Setup:
        """The robot of a trial.

        Raises:
            ConfigError: late images of a profile whose images come at once.
        """
        trials = [Trial.draw(seed)]
        (setup,) = named_setups(
            self.robot, self.grid, self.camera, self.profile, [terrain], trials
        )  # fmt: skip
        usual_s = float(setup.profile.camera_chain.latency.latency)
        if self.conditions.camera_late_s and usual_s == 0.0:
            raise ConfigError(
                f"camera_late_s: images of profile {self.profile} come at once: "
                "use one with a camera_latency, e.g. shipped"
            )
        return replace(setup, trial=self.conditions.trial(seed, usual_s))


@dataclass(frozen=True, kw_only=True)
class CrossingResult:
    """How one robot's walk across a ground went."""

    seed: int
    speed_mps: float
    """As commanded."""
    cause: WalkEndCause
    """Reason why it did not; empty where it did."""
    distance_m: float
    time_s: float
    """From `BEGINS_S` to the end."""


WalkTrialResult = CrossingResult | DrillResult | ErrandResult
WalkTrialRun = Callable[[WalkRun, int], WalkTrialResult]
"""Leads a robot through something, by a seed, and judges it."""


def prepare_trial(
    kind: WalkTrialKind, name: str, seed: int, angles: JumpAngles
) -> tuple[Terrain, WalkTrialRun]:
    """The ground of a trial and what is done on it; `ConfigError` where there is no such ground."""
    if kind == "jump":
        terrain = jumped_ground(name, seed, angles.askew_deg)
        return terrain, partial(run_jump, angles=angles, finish_m=terrain.finish_x)
    if kind == "jump_stop":
        return jumped_ground(name, seed), partial(run_stop, jumps=True)
    if kind == "route":
        drawn = make_route(name, seed)
        return drawn.terrain, partial(run_route, route=drawn)
    if kind == "drill":
        return drill_ground(name, seed), run_drill
    if kind == "line":
        return drill_ground(name, seed), run_line
    return make_walk_ground(name, seed), cross if kind == "cross" else run_stop


@dataclass(frozen=True, kw_only=True)
class WalkTrialTask:
    """Some walking trials, for one process."""

    kind: WalkTrialKind
    ground: str
    seeds: tuple[int, ...]
    source: RobotHeightSourceFactory

    def run(self, trials: WalkTrials) -> list[WalkTrialResult]:
        """Runs them one after the other."""
        results: list[WalkTrialResult] = []
        policy, tick = JointPolicy(trials.model), None
        for seed in self.seeds:
            terrain, attempt = prepare_trial(self.kind, self.ground, seed, trials.angles)
            setup = trials.setup(terrain, seed)
            tick = tick or CompiledTickLaw(setup.robot)
            places = setup.grid.places_of(policy.description.height_grid())
            movers: list[Mover] = [Walker(setup.robot, policy, places)]
            if self.kind in ("jump", "jump_stop"):
                lines = FeetLines(setup.grid, jumping_grid(setup.robot))
                movers.append(Jumper(setup.robot, jumping_planner(setup.robot), lines=lines))
            source = self.source(setup)

            def run(operator: WalkOperator, here: Setup = setup) -> Iterator[WalkStep]:
                push_ns = trials.conditions.push_ns
                # at once: the loop's variables are those of now
                return walk_steps(here, movers, source, operator, tick, push_ns)  # noqa: B023

            results.append(attempt(run, seed))
            tell_progress(1.0)
        return results


def trial_tasks(
    kind: WalkTrialKind,
    names: Sequence[str],
    source: RobotHeightSourceFactory,
    seeds: Sequence[int],
) -> list[WalkTrialTask]:
    """Trials of some grounds, split up for several processes."""
    parts = [tuple(seeds[i : i + SEEDS_AT_A_TIME]) for i in range(0, len(seeds), SEEDS_AT_A_TIME)]
    return [
        WalkTrialTask(kind=kind, ground=name, seeds=part, source=source)
        for name in names
        for part in parts
    ]


def run_tasks(
    trials: WalkTrials,
    todo: Sequence[WalkTrialTask],
    processes: int | None = None,
    listener: WorkerListener | None = None,
) -> list[list[WalkTrialResult]]:
    """The results of each task; `listener` is told of each trial."""
    return list(in_order(_Runner(trials), todo, processes, listener))


@dataclass(frozen=True)
class _Runner:
    trials: WalkTrials

    def __call__(self, task: WalkTrialTask) -> list[WalkTrialResult]:
        return task.run(self.trials)


def cross(run: WalkRun, seed: int) -> CrossingResult:
    """Leads a robot over ten metres; the seed draws the speed."""
    speed = drawn_speed(seed)
    limit_s = BEGINS_S + SLACK * FINISH_X / speed

    def operator(time_s: float, truth: PlantState) -> Wish:
        del time_s
        return walk_along_x(truth, speed)

    for step in run(operator):
        x, y = step.truth.position_base_in_world[:2]
        cause = failure_reason(step)
        if not cause and abs(y) > 0.5 * WIDTH_M:
            cause = "left"
        if not cause and step.time_s > limit_s:
            cause = "time_limit"
        if cause or x >= FINISH_X:
            break
    return CrossingResult(
        seed=seed, speed_mps=speed, cause=cause, distance_m=float(x),
        time_s=step.time_s - BEGINS_S,
    )  # fmt: skip


def crossing_row(results: Sequence[CrossingResult]) -> dict[str, Any]:
    """The figures of one ground."""
    crossed = [each for each in results if not each.cause]
    speeds = [FINISH_X / each.time_s / each.speed_mps for each in crossed]
    return {
        "trials": len(results),
        "successes": len(crossed),
        "success_interval95": list(success_interval(len(crossed), len(results))),
        "failures": dict(Counter(each.cause for each in results if each.cause)),
        "speed_by_commanded": median_or_none(speeds),
        "distance_m": median_or_none([each.distance_m for each in results]),
        "outcomes": [vars(each) for each in results],
    }


ROWS: dict[WalkTrialKind, Callable[..., dict[str, Any]]] = {
    "cross": crossing_row, "drill": drill_row,
    "route": errand_row, "stop": errand_row, "line": errand_row,
    "jump": errand_row, "jump_stop": errand_row,
}  # fmt: skip
"""The figures of the results of each kind."""
