"""Kills camera, heightmap service and planner at random phases of the gait during real-time runs.

    saltus bench faults --arguments --trials --arguments 10

Prints a line a trial and, last, one JSON object with the worst case of each process.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path

import numpy as np

from saltus.config import RunConfig, TerrainConfig
from saltus.runtime.faults import PRODUCT, judge, kill_during_run
from saltus.wire.messages import ControllerMode


def main() -> None:
    """Runs the trials."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=5, help="kills of each process")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    table = {}
    for process in PRODUCT:
        results = []
        for trial in range(options.trials):
            after_s = float(rng.uniform(0.5, 2.5))  # more than a cycle of the gait: every phase
            config = RunConfig(
                terrain=TerrainConfig(terrain="flat"), pace="realtime", planner="scripted", seed=options.seed + trial
            )
            with tempfile.TemporaryDirectory() as directory:
                recording = kill_during_run(config, Path(directory), process, after_s)
                results.append(judge(recording, process, after_s))
            print(results[-1], file=sys.stderr, flush=True)
        table[process] = {
            "trials": len(results),
            "told_ms_max": max(result.told_ms for result in results),
            "back_s_max": max(result.back_s for result in results),
            "stopped": sum(result.mode == ControllerMode.STOPPED for result in results),
            "upright": sum(result.upright for result in results),
        }
    print(json.dumps({"faults": table}))


if __name__ == "__main__":
    main()
