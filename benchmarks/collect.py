"""How fast data for the heightmap predictor are collected with the shipped predictor in the loop.

Labelled steps of 10 ms a second, with rendering, late and lost images, network, planners, physics, and the images that
are kept; by the clock, by the clock after the processes have started, and by a second of one core's work, which other
programs on the machine disturb less. With --gpu batches of 8,192 robots are led by the learned policy on a GPU, stereo
images and predictor included. Shards are written to a temporary folder.

    OMP_NUM_THREADS=1 saltus bench collect -- --batches 2
"""

import resource
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from benchmarks._command import Command
from saltus.config import check_at_least
from saltus.heightmap.data.closed_loop import ClosedLoop
from saltus.heightmap.data.shards import Episode, write_shard
from saltus.resources import resource as shipped
from saltus.workers import in_order


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    """Flags of this benchmark."""

    processes: int = 2
    """That collect side by side."""
    batches: int = 6
    """More than there are processes."""
    robots: int | None = None
    """In a batch, each for 6 s; 32 by default, on a GPU 8,192."""
    gpu: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """On a GPU instead; needs a checkpoint of policy and predictor, which a checkout has."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_at_least(self, batches=1 if self.gpu else self.processes + 1)

    def measure(self) -> dict[str, Any]:
        """See `Command`."""
        with tempfile.TemporaryDirectory() as folder:
            return self._on_gpu(Path(folder)) if self.gpu else self._on_cores(Path(folder))

    def _on_cores(self, folder: Path) -> dict[str, Any]:
        marks: list[tuple[float, int]] = [(time.perf_counter(), 0)]
        work = partial(ClosedLoop(robots=self.robots or 32).episodes, shipped("models/heightmap.onnx"))
        keys = [(0, 0, batch) for batch in range(self.batches)]

        def episodes() -> Iterator[Episode]:
            for batch in in_order(work, keys, self.processes):
                yield from batch
                marks.append((time.perf_counter(), sum(len(episode.height) for episode in batch)))

        ticks = write_shard(folder, episodes(), seed=0, config={}).ticks
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

    def _on_gpu(self, folder: Path) -> dict[str, Any]:
        from saltus.heightmap.data.device_rollouts import DeviceLoop
        from saltus.heightmap.training.gpu_rollouts import POLICY, BatchProgress, collect

        done: list[BatchProgress] = []
        loop = DeviceLoop(robots=self.robots or 8192)
        policy, predictor = shipped(str(POLICY)), shipped("models/checkpoints/heightmap.pt")
        collect(
            {"d435i": folder}, loop, policy=policy, predictor=predictor, batches=self.batches, seed=0, device="cuda",
            done=done.append,
        )  # fmt: skip
        last = done[-1]
        speed = {"steps_per_s": last.ticks / last.moving_s, "steps_per_s_with_writing": last.ticks / last.seconds}
        return {name: round(value) for name, value in speed.items()}


def _cpu_s() -> float:
    """Work of this process and of those that it has started, their start included [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)
