"""Kills camera, heightmap service and planner at random phases of the gait during real-time runs.

The clock of the run may be slowed, all limits with it. Results are kept in a file, and the same
command adds to them; beside it stay the recordings of runs in which something too old was used.

    saltus bench faults -- --trials 10
    saltus bench faults -- --terrain stairs --planner learned --trials 20 --speed 0.3 --out runs/faults.jsonl
"""

import json
import shutil
import tempfile
from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks._command import Command, progress, tell
from benchmarks._judgement import PRODUCT, judge
from benchmarks._kills import kill_during_run
from saltus.config import RunConfig, TerrainConfig
from saltus.recordings.recorder import RECORDING_FILE
from saltus.runtime.programs import PROGRAMS, WITH_STANDBYS

COURSE_S = 20.0  # the time limit of a trial
COURSES = {
    "flat": TerrainConfig(terrain="flat"),
    "stairs": TerrainConfig(terrain="stairs", rise_m=0.2),
    "stepping_stones": TerrainConfig(terrain="stepping_stones", gap_m=0.1, gap_max_m=0.5),
}


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    terrain: Literal["flat", "stairs", "stepping_stones"] = "flat"
    """Terrain that the robot crosses: flat ground, stairs of 0.20 m, stones with gaps of 0.1 to 0.5
    m."""
    planner: Literal["learned", "scripted"] = "scripted"
    """Planner that leads it; the scripted one crosses flat ground alone."""
    trials: int = 5
    """Kills of each process."""
    seed: int = 0
    """Seed of the first trial, and of the moments of the kills."""
    speed: float = 1.0
    """Speed of the clock of the runs."""
    standbys: bool = False
    """True where service and planner have standbys that work along."""
    out: Path | None = None
    """File of results so far, to go on from; by default none is kept."""

    def measure(self) -> dict[str, Any]:
        """The worst case of each process."""
        kept = (
            []
            if self.out is None or not self.out.is_file()
            else self.out.read_text(encoding="utf-8").splitlines()
        )
        key = [self.terrain, self.planner, self.standbys]
        rows = [row for row in map(json.loads, kept) if row["course"] == key and "stale" in row]
        done = {(row["process"], row["seed"]): row for row in rows}
        table = {}
        for process in PRODUCT:
            seeds = range(self.seed, self.seed + self.trials)
            for seed in progress([seed for seed in seeds if (process, seed) not in done], process):
                row = {"course": key, "seed": seed, **self._kill(process, seed)}
                done[process, seed] = row
                tell(str(row))
                if self.out is not None:
                    with self.out.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(row) + "\n")
            table[process] = summary([done[process, seed] for seed in seeds])
        return {"faults": {"terrain": self.terrain, "planner": self.planner, **table}}

    def _kill(self, process: str, seed: int) -> dict[str, Any]:
        # between 0.5 and 2.5 s lies more than a cycle of the gait: every phase
        after_s = float(np.random.default_rng([seed, *process.encode()]).uniform(0.5, 2.5))
        terrain = replace(COURSES[self.terrain], layout_seed=seed)
        config = RunConfig(
            robot="go1",
            grid="line",
            terrain=terrain,
            pace="realtime",
            planner=self.planner,
            seed=seed,
            speed=self.speed,
        )
        with tempfile.TemporaryDirectory() as directory:
            programs = WITH_STANDBYS if self.standbys else PROGRAMS
            recording = kill_during_run(
                config, Path(directory), process, after_s, watch_s=COURSE_S, programs=programs
            )
            result = judge(recording, process, after_s)
            if result.stale and self.out is not None:
                kept = self.out.with_name(f"{self.terrain}-{process}-{seed}.mcap")
                shutil.copyfile(Path(directory) / RECORDING_FILE, kept)
            return asdict(result)


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Summary of the kills of one process."""
    return {
        "trials": len(rows),
        "told_ms_max": max(
            (row["told_ms"] for row in rows if row["told_ms"] < float("inf")), default=None
        ),
        "reported_ms_max": max(row["reported_ms"] for row in rows),
        "back_s_max": max(row["back_s"] for row in rows),
        "silence_ms_max": max(row["silence_ms"] for row in rows),
        "stale": sum(row["stale"] for row in rows),
        "ends": dict(Counter(row["end"] for row in rows)),
    }
