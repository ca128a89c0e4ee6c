"""How fast data for the heightmap predictor are collected with the shipped predictor in the loop.

Labelled steps of 10 ms a second, with rendering, late and lost images, network, planners, physics,
and the images that are kept; by the clock, by the clock after the processes have started, and by a
second of one core's work, which other programs on the machine disturb less. Shards are written to a
temporary folder. On a GPU `saltus heightmap collect` says itself how fast it is.

    OMP_NUM_THREADS=1 saltus bench collect -- --processes 1 --batches 2
"""

import resource
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks._command import Command
from saltus.config import check_between
from saltus.heightmap.data.closed_loop import closed_loop_episodes
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.shards import write_shard
from saltus.heightmap.settings import ClosedLoop
from saltus.resources import shipped_file as shipped
from saltus.workers import in_order


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    processes: int = 2
    """Processes that collect side by side."""
    batches: int = 6
    """More than there are processes."""
    robots: int = 32
    """In a batch, each for 6 s."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_between(self, batches=(self.processes + 1, 10**6))

    def measure(self) -> dict[str, Any]:
        marks: list[tuple[float, int]] = [(time.perf_counter(), 0)]
        work = partial(
            closed_loop_episodes,
            ClosedLoop(robot="go1", grid="line", robots=self.robots),
            shipped("models/heightmap.onnx"),
        )
        keys = [(0, 0, batch) for batch in range(self.batches)]

        def episodes() -> Iterator[Episode]:
            for batch in in_order(work, keys, self.processes):
                yield from batch
                marks.append((time.perf_counter(), sum(len(episode.height) for episode in batch)))

        with tempfile.TemporaryDirectory() as folder:
            ticks = write_shard(Path(folder), episodes(), seed=0, config={}).ticks
        began, first, last = marks[0][0], marks[self.processes][0], marks[-1][0]
        later = sum(count for _, count in marks[self.processes + 1 :])
        table = {
            "processes": self.processes,
            "labelled_steps": ticks,
            "steps_per_s": ticks / (time.perf_counter() - began),
            "steps_per_s_when_started": later / (last - first),
            "steps_per_core_s": ticks / _cpu_s(),
        }
        return {name: round(value) for name, value in table.items()}


def _cpu_s() -> float:
    """Work of this process and of those that it has started, their start included [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)
