"""A real-time run of the whole stack: rates, ages of messages,
processor time of each process and where it goes.

Seconds are those of the run. A computer that is too slow keeps up at a lower `--speed`, and its
processor time a second of the run stays comparable, but for what waiting costs: a part of its own.

saltus bench stack -- --terrain stairs --speed 0.5
"""

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._command import Command
from benchmarks._measuring import percentiles
from benchmarks._parts import Meter, Spent, metered, spent_by
from saltus.config import RunConfig, TerrainConfig
from saltus.recordings.recording import Recording, read_recording
from saltus.recordings.timing import rates_and_ages
from saltus.runtime.programs import PROGRAMS
from saltus.runtime.stack import Stack
from saltus.wire.messages import ProcessStatus


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    terrain: str = "flat"
    """Terrain that the robot crosses."""
    camera: str = "ideal"
    """Depth camera: ideal, d435i, or a TOML file."""
    seed: int = 0
    """Seed of the trial."""
    speed: float = 1.0
    """Seconds of the run for each second of this computer."""

    def measure(self) -> dict[str, Any]:
        load = os.getloadavg()[0]
        config = RunConfig(
            robot="go1", grid="line", terrain=TerrainConfig(terrain=self.terrain),
            camera=self.camera, seed=self.seed,
            pace="realtime", speed=self.speed,
        )  # fmt: skip
        recording, spent = _metered_run(config)
        topics = {
            topic: {
                "hz": row.rate_hz,
                "p50": row.age_p50_ms,
                "p99": row.age_p99_ms,
                "lost": row.lost,
            }
            for topic, row in rates_and_ages(recording).items()
        }
        seconds = _seconds(recording)
        ticks = np.array(spent["controller"].ticks_us)
        return {
            "control_hz": control_rate_hz(recording),
            "load": load,
            "control tick [us]": percentiles(ticks[:, 0]),
            "the same beside its laws [us]": percentiles(ticks[:, 1]),
            "topics": topics,
            "processor time [ms] a second of the run": {
                name: _row(one, seconds) for name, one in spent.items()
            } | {"all": sum(round(1e3 * one.total / seconds) for one in spent.values())},
            "microseconds a call, of zenoh a message": {
                f"{name}: {part}": round(1e6 * one.parts[part] / calls, 1)
                for name, one in spent.items() for part,
                calls in one.calls.items() if part != "waiting"
            },
        }  # fmt: skip


def _metered_run(config: RunConfig) -> tuple[Recording, dict[str, Spent]]:
    """A run of the whole stack, and what its processes and its supervisor spent."""
    with tempfile.TemporaryDirectory() as directory:
        folder = Path(directory)
        with metered(PROGRAMS, folder) as programs, Stack(config, folder, programs) as stack:
            meter = Meter()
            stack.wait()
            own = meter.end()
        return read_recording(stack.recording), {**spent_by(programs, folder), "supervisor": own}


def _row(spent: Spent, seconds: float) -> dict[str, float]:
    """Milliseconds a second of the run: all, then by part, the largest first."""
    parts = sorted(spent.parts.items(), key=lambda part: -part[1])
    return {name: round(1e3 * used / seconds, 1) for name, used in [("all", spent.total), *parts]}


def _seconds(recording: Recording) -> float:
    """Time of the run between the controller's first and last sign of life."""
    statuses = recording.of(ProcessStatus, "status/controller")
    return 1e-9 * (statuses[-1].time_ns - statuses[0].time_ns)


def control_rate_hz(recording: Recording) -> float:
    """Ticks that the control loop ran per second, from its first and last sign of life."""
    statuses = recording.of(ProcessStatus, "status/controller")
    if len(statuses) < 2:
        return float("nan")
    first, last = statuses[0], statuses[-1]
    return 1e9 * (last.ticks - first.ticks) / (last.time_ns - first.time_ns)
