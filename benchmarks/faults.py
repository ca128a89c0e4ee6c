"""Kills camera, heightmap service and planner at random phases of the gait during real-time runs.

saltus bench faults -- --trials 10
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._command import Command, progress, tell
from saltus.config import RunConfig, TerrainConfig
from saltus.runtime.faults import PRODUCT, FaultResult, judge, kill_during_run
from saltus.wire.messages import ControllerMode


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    trials: int = 5
    """Kills of each process."""
    seed: int = 0
    """Of the first trial, and of the moments of the kills."""

    def measure(self) -> dict[str, Any]:
        """The worst case of each process."""
        rng = np.random.default_rng(self.seed)
        table = {}
        for process in PRODUCT:
            # between 0.5 and 2.5 s lies more than a cycle of the gait: every phase
            moments = rng.uniform(0.5, 2.5, self.trials).tolist()
            results = [
                self._kill(process, self.seed + trial, after_s)
                for trial, after_s in enumerate(progress(moments, process))
            ]
            table[process] = {
                "trials": len(results),
                "told_ms_max": max(result.told_ms for result in results),
                "back_s_max": max(result.back_s for result in results),
                "stopped": sum(result.mode == ControllerMode.STOPPED for result in results),
                "upright": sum(result.upright for result in results),
            }
        return {"faults": table}

    def _kill(self, process: str, seed: int, after_s: float) -> FaultResult:
        config = RunConfig(terrain=TerrainConfig(terrain="flat"), pace="realtime", planner="scripted", seed=seed)
        with tempfile.TemporaryDirectory() as directory:
            result = judge(kill_during_run(config, Path(directory), process, after_s), process, after_s)
        tell(str(result))
        return result
