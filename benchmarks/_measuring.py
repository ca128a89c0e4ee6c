"""Instruments of benchmarks: times of calls, work and memory of processes,
runs of the stack, random images.
"""

import multiprocessing
import os
import signal
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeVar

import numpy as np

from saltus.arrays import Floats
from saltus.depth import Intrinsics, depth_frame
from saltus.wire.messages import DepthFrame

if TYPE_CHECKING:
    from saltus.config import RunConfig
    from saltus.recordings.recording import Recording

Result = TypeVar("Result")


def percentiles(
    values: Sequence[float] | Floats,
    which: Sequence[int] = (50, 99),
    method: Literal["linear", "higher"] = "linear",
) -> dict[str, float]:
    """Percentiles by their names "p50" and so on."""
    found = np.percentile(values, which, method=method)
    return {f"p{share}": round(float(value), 3) for share, value in zip(which, found, strict=True)}


class Stopwatch:
    """Times of many calls [us], on the wall and as work of this thread,
    which other programs hardly change.

    Args:
        skip: So many first calls do not count.
    """

    def __init__(self, skip: int = 0) -> None:
        self.wall_us: list[float] = []
        self.cpu_us: list[float] = []
        self._skip = skip

    def __call__(self, function: Callable[..., Result], *arguments: object) -> Result:
        """Calls and takes the time."""
        wall, cpu = time.perf_counter_ns(), time.thread_time_ns()
        result = function(*arguments)
        cpu, wall = time.thread_time_ns() - cpu, time.perf_counter_ns() - wall
        self._skip -= 1
        if self._skip < 0:
            self.cpu_us.append(1e-3 * cpu)
            self.wall_us.append(1e-3 * wall)
        return result

    def percentiles(self) -> dict[str, float]:
        """Percentiles of both times [us]."""
        wall, cpu = percentiles(self.wall_us), percentiles(self.cpu_us)
        return {f"{name}_us": value for name, value in wall.items()} | {
            f"cpu_{k}_us": v for k, v in cpu.items()
        }


def own_processes() -> list[int]:
    """Numbers of this process and of those that it has started with `multiprocessing`."""
    return [
        os.getpid(),
        *(child.pid for child in multiprocessing.active_children() if child.pid is not None),
    ]


def processor_s(processes: Iterable[int]) -> float:
    """Processor time that processes have used."""
    fields = [
        Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        for pid in processes
    ]
    return sum(int(f[11]) + int(f[12]) for f in fields) / os.sysconf("SC_CLK_TCK")


SIGNALS = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
"""By which people and systems end a command."""


def hear_signals() -> None:
    """As in a terminal, also where the benchmark was started to ignore them (nohup, &):
    for what is started.
    """
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)


def resident_mb(processes: Iterable[int]) -> float:
    """Memory of processes."""
    pages = sum(
        int(Path(f"/proc/{pid}/statm").read_text(encoding="utf-8").split()[1]) for pid in processes
    )
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


class Use(NamedTuple):
    """Resources that a process holds."""

    memory_mb: float
    """Its own, without what it maps from files (RssAnon)."""
    handles: int
    threads: int


def use_of(pid: int) -> Use:
    """Returns what a process holds now."""
    status = dict(
        line.split(":", 1)
        for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    )
    memory_mb = int(status["RssAnon"].split()[0]) * 1024 / 1e6
    return Use(memory_mb, len([*Path(f"/proc/{pid}/fd").iterdir()]), int(status["Threads"]))


def recorded_run(config: "RunConfig") -> "Recording":
    """A run of the whole stack, from its start to its end."""
    from saltus.recordings.recording import read_recording
    from saltus.runtime.stack import Stack

    with tempfile.TemporaryDirectory() as directory:
        with Stack(config, Path(directory)) as stack:
            stack.wait()
        return read_recording(Path(directory) / "recording.mcap")


def random_frames(camera: Intrinsics, count: int, rng: np.random.Generator) -> list[DepthFrame]:
    """Images of noise, 0.3 to 2.5 m away."""
    scenes = rng.integers(300, 2500, (count, camera.height, camera.width)).astype(np.uint16)
    return [depth_frame(camera, scene) for scene in scenes]
