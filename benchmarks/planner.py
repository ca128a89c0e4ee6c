"""How often the scripted planner succeeds, on fresh seeds, and what it costs.

    OMP_NUM_THREADS=1 python benchmarks/planner.py [--trials 20] [--first-seed 0]

Every row is `saltus policy eval` on one terrain: profile go1 (torque saturation, torque-speed limit, 10 ms
feed-forward delay), trial randomisation on, true heights with each trial's shift unless the row says "true-exact".
Prints one line a row on the way, and one JSON object at the end.
"""

import argparse
import json
import time
from dataclasses import replace

import numpy as np

from saltus.cli.output import finite
from saltus.config import TerrainConfig
from saltus.policy.evaluation.evaluate import HEIGHTS, Evaluation, collect, evaluate
from saltus.policy.observation import observe
from saltus.policy.scripted import ScriptedPlanner
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


def main() -> None:
    """Measures every row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    options = parser.parse_args()
    rows = {}
    for name, (course, heights) in ROWS.items():
        evaluation = Evaluation(course=course, trials=options.trials, seed=options.first_seed)
        result = collect(evaluate(evaluation, HEIGHTS[heights]))
        rows[name] = {
            "success": result.successes,
            "trials": options.trials,
            "mean_speed_mps": result.mean_speed_mps,
            "failures": result.failures,
        }
        print(f"{name}: {result.successes} of {options.trials}, {result.mean_speed_mps:.2f} m/s", flush=True)
    print(json.dumps(finite({"first_seed": options.first_seed, "rows": rows, "plan_ms": plan_ms()})))


def plan_ms() -> dict[str, float]:
    """Time of one plan for a single robot."""
    observation = observe(
        replace(
            standing_state(0.28),
            velocity_base_in_world=np.array([1.0, 0.0, 0.0]),
            leg_contact=np.array([True, True, False, False]),
            leg_progress=np.array([0.3, 0.3, 0.6, 0.6]),
        )
    )
    planner, heights = ScriptedPlanner(), np.full(30, -0.28)
    times = np.empty(PLANS)
    for i in range(PLANS):
        start = time.perf_counter()
        planner.step(observation, heights)
        times[i] = 1e3 * (time.perf_counter() - start)
    return {"p50": float(np.percentile(times, 50)), "p99": float(np.percentile(times, 99))}


if __name__ == "__main__":
    main()
