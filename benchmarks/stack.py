"""A real-time run of the whole stack: the rates it holds, the ages of its messages, what is lost.

saltus bench stack -- --terrain stairs
"""

import os
from dataclasses import dataclass
from typing import Any

from benchmarks._command import Command
from benchmarks._measuring import recorded_run
from saltus.config import RunConfig, TerrainConfig
from saltus.recordings.recording import Recording, rates_and_ages
from saltus.wire.messages import ProcessStatus


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    terrain: str = "flat"
    """Terrain that the robot crosses."""
    seed: int = 0
    """Seed of the trial."""

    def measure(self) -> dict[str, Any]:
        load = os.getloadavg()[0]
        config = RunConfig(
            robot="go1", grid="line", terrain=TerrainConfig(terrain=self.terrain), pace="realtime", seed=self.seed
        )
        recording = recorded_run(config)
        topics = {
            topic: {"hz": row.rate_hz, "p50": row.age_p50_ms, "p99": row.age_p99_ms, "lost": row.lost}
            for topic, row in rates_and_ages(recording).items()
        }
        return {"control_hz": control_rate_hz(recording), "load": load, "topics": topics}


def control_rate_hz(recording: Recording) -> float:
    """Ticks that the control loop ran per second, from its first and last sign of life."""
    statuses = recording.of(ProcessStatus, "status/controller")
    if len(statuses) < 2:
        return float("nan")
    first, last = statuses[0], statuses[-1]
    return 1e9 * (last.ticks - first.ticks) / (last.time_ns - first.time_ns)
