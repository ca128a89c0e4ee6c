"""How often the scripted planner succeeds on each terrain, and how long a plan takes.

Every row is `saltus policy eval` on one terrain: profile go1 (torque saturation, torque-speed
limit, 10 ms feed-forward delay), trial randomisation on, true heights with each trial's shift
unless the row says "exact".

    OMP_NUM_THREADS=1 saltus bench planner -- --trials 20 --seed 20000
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks._command import Command, progress
from benchmarks._measuring import Stopwatch
from saltus.config import TerrainConfig
from saltus.grid import LINE
from saltus.loop.planner import Observation, observe
from saltus.policy.evaluation.evaluate import (
    HEIGHTS,
    EvaluationSettings,
    evaluate_policy,
    merge_batches,
)
from saltus.policy.scripted import ScriptedPlanner
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.states import standing_state

STAIRS = TerrainConfig(terrain="stairs", steps=14, rise_m=0.06, run_m=0.25)
ROWS = {
    "flat": (TerrainConfig(terrain="flat"), "true"),
    "stairs 6 cm": (STAIRS, "true"),
    "stairs 6 cm, exact": (STAIRS, "true-exact"),
    "stairs 8 cm": (TerrainConfig(terrain="stairs", rise_m=0.08), "true"),
    "stepping stones, gaps 0.1 m": (TerrainConfig(terrain="stepping_stones", gap_m=0.1), "true"),
    "stepping stones, gaps 0.2 m": (TerrainConfig(terrain="stepping_stones", gap_m=0.2), "true"),
    "gap 0.2 m": (TerrainConfig(terrain="gap", gap_m=0.2), "true"),
    "gap 0.3 m": (TerrainConfig(terrain="gap", gap_m=0.3), "true"),
    "step 0.1 m": (TerrainConfig(terrain="step", height_m=0.1), "true"),
    "step 0.2 m": (TerrainConfig(terrain="step", height_m=0.2), "true"),
}
PLANS = 2000


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    trials: int = 20
    """In each row."""
    seed: int = 0
    """Seed of the first trial of each row."""

    def measure(self) -> dict[str, Any]:
        rows = {name: self._row(*row) for name, row in progress(ROWS.items())}
        return {"first_seed": self.seed, "rows": rows, "plan": plan_times()}

    def _row(self, course: TerrainConfig, heights: str) -> dict[str, Any]:
        evaluation = EvaluationSettings(
            robot="go1", grid="line", course=course, trials=self.trials, seed=self.seed
        )
        result = merge_batches(evaluate_policy(evaluation, HEIGHTS[heights]))
        return {
            "success": result.successes,
            "trials": self.trials,
            "mean_speed_mps": result.mean_speed_mps,
            "failures": result.failures,
        }


def bounding(
    robot: Robot, base_height: float, contact: tuple[bool, bool], progress: tuple[float, float]
) -> Observation:
    """A level robot that bounds at 1 m/s: height of its base [m],
    contact and progress of front and rear feet.
    """
    return observe(
        replace(
            standing_state(robot),
            base_height=base_height,
            velocity_base_in_world=np.array([1.0, 0.0, 0.0]),
            leg_contact=np.repeat(contact, 2),
            leg_progress=np.repeat(progress, 2),
        ),
        LegKinematics(robot),
    )


def plan_times() -> dict[str, float]:
    """Times of one plan for a single robot."""
    robot = load_robot(DEFAULT_ROBOT)
    observation = bounding(robot, 0.28, (True, False), (0.3, 0.6))
    planner, heights, watch = ScriptedPlanner(robot, LINE), np.full(30, -0.28), Stopwatch()
    for _ in range(PLANS):
        watch(planner.step, observation, heights)
    return watch.percentiles()
