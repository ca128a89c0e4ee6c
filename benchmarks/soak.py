"""Hours of the stack, or of one heightmap service of several robots,
under random faults: what grows, what ages.

stack: camera, service and planner are killed, and images are held up. fleet: images are lost, and
robots start anew.

    saltus bench soak -- --hours 1 --out runs/soak.jsonl
    saltus bench soak -- --what fleet --hours 1 --speed 0.25 --out runs/soak.jsonl

Hours are those of the run's clock. They are made of goes, each a run of its own; the same command
adds goes to the file until its hours are full. Memory is what a process does not share with its
file (RssAnon). A slope is the median over pairs of samples of one process that are half of its life
apart (Theil and Sen), after its warm-up.
"""

import contextlib
import json
import os
import signal
import statistics
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks._command import Command, progress
from benchmarks._judgement import PRODUCT
from benchmarks._measuring import Use, percentiles, use_of
from benchmarks.transport import Scenes, served
from saltus.clock import RunClock
from saltus.config import RunConfig, TerrainConfig
from saltus.errors import StackError
from saltus.runtime.stack import HUNG_S, POLL_S, Stack
from saltus.runtime.ticker import Ticker
from saltus.wire.bus import Sample
from saltus.wire.zenoh_bus import ZenohBus

PERIOD_S = 5.0  # from sample to sample
LONGEST_LOSS_S = 1.0  # of images: longer than the service bridges, shorter than what counts as hung
STEP_HZ = 100.0
SETTLED_S = 2.0  # after a fault nothing else fails: faults are to be told apart
SERVICE = "heightmap"
QUARTERS = 4  # early is the first quarter of a series, late the last

Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    what: Literal["stack", "fleet"] = "stack"
    """One full stack, or one service and the states and images of several robots."""
    hours: float = 1.0
    """In all, in the run's clock."""
    go_s: float = 1800.0
    """Length of one run."""
    apart_s: float = 120.0
    """From fault to fault, on average."""
    killed: tuple[Literal["render", "heightmap", "policy"], ...] = ("render", "heightmap", "policy")
    """Processes of the stack that are killed; one that is not lives as long as the run.

    None: only images are lost.
    """
    warm_up_s: float = 60.0
    """Beginning of each process that is not measured."""
    robots: int = 8
    """Robots of the fleet."""
    speed: float = 1.0
    """Speed of the run's clock."""
    seed: int = 0
    out: Path | None = None
    """File of samples so far, to go on from; by default none is kept."""

    def measure(self) -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder:  # not in memory: this process is measured too
            path = self.out or Path(folder) / "soak.jsonl"
            rows = self._read(path)
            first = max((row["go"] for row in rows), default=-1) + 1
            left_s = 3600.0 * self.hours - sum(lengths_s(rows).values())
            rows.clear()
            for go in progress(range(first, first + max(0, round(left_s / self.go_s))), self.what):
                for row in self._go(np.random.default_rng([self.seed, go])):
                    with path.open("a", encoding="utf-8") as file:
                        file.write(json.dumps({"what": self.what, "go": go, **row}) + "\n")
            return {"soak": {"what": self.what, **summary(self._read(path), self.warm_up_s)}}

    def _read(self, path: Path) -> list[Row]:
        lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
        return [row for row in map(json.loads, lines) if row["what"] == self.what]

    def _go(self, rng: np.random.Generator) -> Iterator[Row]:
        config = RunConfig(
            robot="go1",
            grid="line",
            terrain=TerrainConfig(terrain="flat"),
            pace="realtime",
            speed=self.speed,
            time_limit_s=self.go_s,
            epoch_ns=time.monotonic_ns(),
            prefix="soak/0",
            seed=int(rng.integers(2**31)),
        )
        config.check()
        return self._stack(config, rng) if self.what == "stack" else self._fleet(config, rng)

    def _stack(self, config: RunConfig, rng: np.random.Generator) -> Iterator[Row]:
        """Rows of one run of the whole stack."""
        with tempfile.TemporaryDirectory() as folder, Stack(config, Path(folder)) as stack:
            names = [*PRODUCT, "controller"]
            watch = UsageWatch(
                config, {topic: stack.latest(topic).take for topic in PRODUCT.values()}
            )
            # the first comes while the robot jumps, as in `saltus bench faults`; after it the robot
            # stands
            faults = Faults(watch.clock, rng, self.apart_s, first_s=float(rng.uniform(1.5, 3.5)))
            held: tuple[int, float] | None = None
            while not stack.wait(POLL_S * config.speed):
                if held is not None and watch.clock.elapsed_s() >= held[1]:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(held[0], signal.SIGCONT)
                    held = None
                if faults.due():
                    name = str(rng.choice([*self.killed, "images"]))
                    with contextlib.suppress(StackError):  # it is being started again
                        if name == "images":
                            pid, until_s = (
                                stack.pid("render"),
                                watch.clock.elapsed_s() + loss_s(rng),
                            )
                            held = pid, until_s
                            os.kill(pid, signal.SIGSTOP)
                        else:
                            os.kill(stack.pid(name), signal.SIGKILL)
                        yield {"time_s": watch.clock.elapsed_s(), "fault": name}
                    continue  # what was killed is not there to be sampled
                yield from watch.sample(
                    lambda: {"supervisor": os.getpid(), **running(stack, names)}
                )
            yield {
                "end": {
                    "rejected": stack.rejected,
                    "overruns": stack.overruns,
                    "restarts": stack.restarts,
                }
            }

    def _fleet(self, config: RunConfig, rng: np.random.Generator) -> Iterator[Row]:
        """Rows of one service, whose robots are all in this process."""
        prefixes = [f"soak/{number}" for number in range(self.robots)]
        with served(config, prefixes) as (endpoint, service), contextlib.ExitStack() as resources:
            scenes = Scenes()
            robots = [
                resources.enter_context(contextlib.closing(FleetRobot(endpoint, prefix)))
                for prefix in prefixes
            ]
            watch = UsageWatch(config, {robot.prefix: robot.take for robot in robots})
            faults = Faults(watch.clock, rng, self.apart_s / self.robots, first_s=self.apart_s)
            ticker = Ticker(STEP_HZ, clock=watch.clock)
            while watch.clock.elapsed_s() < config.time_limit_s:
                ticker.wait()
                if faults.due():
                    robot = robots[int(rng.integers(self.robots))]
                    name = str(rng.choice(["images", "robot"]))
                    if name == "robot":
                        robot.close()
                        robot.start()
                    else:
                        robot.blind_until_s = watch.clock.elapsed_s() + loss_s(rng)
                    yield {"time_s": watch.clock.elapsed_s(), "fault": name}
                for robot in robots:
                    robot.send(scenes, watch.clock)
                yield from watch.sample(lambda: {SERVICE: service})
            yield {"end": {"overruns": {"robots": ticker.overruns}}}


class UsageWatch:
    """Samples what processes use, and how old messages are when they come."""

    def __init__(self, config: RunConfig, takes: dict[str, Callable[[], Sample | None]]) -> None:
        self.clock = RunClock.of(config)
        self._takes = takes
        self._ages_ms: dict[str, list[float]] = defaultdict(list)
        self._next_s = self.clock.elapsed_s() + PERIOD_S

    def sample(self, processes: Callable[[], dict[str, int]]) -> Iterator[Row]:
        """To be called at every step; a row when it is due."""
        for topic, take in self._takes.items():
            found = take()
            if found is not None:
                age_ns = self.clock.of_monotonic(found.arrival_ns) - found.message.time_ns
                self._ages_ms[topic].append(1e-6 * age_ns)
        if self.clock.elapsed_s() < self._next_s:
            return
        self._next_s += PERIOD_S
        ages = {topic: percentiles(ages)["p99"] for topic, ages in self._ages_ms.items()}
        self._ages_ms.clear()
        uses = {name: [pid, *use_of(pid)] for name, pid in processes().items()}
        yield {"time_s": round(self.clock.elapsed_s(), 2), "age_p99_ms": ages, "use": uses}


class Faults:
    """When the next fault is due, at random."""

    def __init__(
        self, clock: RunClock, rng: np.random.Generator, apart_s: float, first_s: float
    ) -> None:
        self._clock, self._rng, self._apart_s = clock, rng, apart_s
        self._next_s = clock.elapsed_s() + first_s

    def due(self) -> bool:
        """True where it is; the next one is drawn."""
        now_s = self._clock.elapsed_s()
        if now_s < self._next_s:
            return False
        self._next_s = now_s + HUNG_S + SETTLED_S + float(self._rng.exponential(self._apart_s))
        return True


class FleetRobot:
    """A robot's place on the bus: a state at every step, an image at every second."""

    def __init__(self, endpoint: str, prefix: str) -> None:
        self.prefix = prefix
        self.blind_until_s = 0.0
        """No images are sent before [s, run's clock]."""
        self._endpoint = endpoint
        self.start()

    def start(self) -> None:
        """As a process that is started, with a boot id of its own."""
        self._bus, self._step = ZenohBus(self._endpoint, self.prefix), 0
        self._frames, self._states = (
            self._bus.publisher(topic) for topic in ("camera/depth", "controller/state")
        )
        self._heightmaps = self._bus.latest("heightmap/heightmap")

    def close(self) -> None:
        """As a process that ends."""
        self._bus.close()

    def send(self, scenes: Scenes, clock: RunClock) -> None:
        """The next step."""
        frame, state = scenes.at(self._step, clock.now_ns())
        if self._step % 2 == 0 and clock.elapsed_s() >= self.blind_until_s:
            self._frames.put(frame)
        self._states.put(state)
        self._step += 1

    def take(self) -> Sample | None:
        """The newest heightmap."""
        return self._heightmaps.take()


def loss_s(rng: np.random.Generator) -> float:
    """How long images do not come."""
    return float(rng.uniform(0.1, LONGEST_LOSS_S))


def running(stack: Stack, names: list[str]) -> dict[str, int]:
    """Process ids of those that run now."""
    found = {}
    for name in names:
        with contextlib.suppress(StackError):
            found[name] = stack.pid(name)
    return found


def lengths_s(rows: list[Row]) -> dict[int, float]:
    """How long each go was."""
    return {row["go"]: row["time_s"] for row in rows if "use" in row}


def summary(rows: list[Row], warm_up_s: float) -> dict[str, Any]:
    """Sums up what grew, what aged, what failed."""
    lives: dict[tuple[str, int, int], list[tuple[float, Use]]] = defaultdict(list)
    ages: dict[str, dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        for name, (pid, *use) in row.get("use", {}).items():
            lives[name, row["go"], pid].append((row["time_s"], Use(*use)))
        for topic, age in row.get("age_p99_ms", {}).items():
            ages[topic][row["go"]].append(age)
    warm: dict[str, list[list[tuple[float, Use]]]] = defaultdict(list)
    for (name, *_), life in lives.items():
        samples = [sample for sample in life if sample[0] >= life[0][0] + warm_up_s]
        if len(samples) >= QUARTERS:
            warm[name].append(samples)
    return {
        "hours": round(sum(lengths_s(rows).values()) / 3600.0, 2),
        "goes": len(lengths_s(rows)),
        "faults": dict(Counter(row["fault"] for row in rows if "fault" in row)),
        "processes": {name: growth(found) for name, found in warm.items()},
        "age_p99_ms_early_late": {
            topic: np.median([early_late(series) for series in goes.values()], axis=0)
            .round(2)
            .tolist()
            for topic, goes in ages.items()
        },
        "ends": [row["end"] for row in rows if "end" in row],
    }


def growth(lives: list[list[tuple[float, Use]]]) -> dict[str, float]:
    """Growth of one process over its lives: slope of its memory,
    most handles and threads that came to it.
    """
    slopes, more = [], []
    for life in lives:
        half = len(life) // 2
        for (begin_s, before), (end_s, after) in zip(life[:-half], life[half:], strict=True):
            slopes.append(3600.0 * (after.memory_mb - before.memory_mb) / (end_s - begin_s))
        pairs = [
            early_late([float(getattr(use, name)) for _, use in life])
            for name in ("handles", "threads")
        ]
        more.append([late - early for early, late in pairs])
    handles, threads = np.max(more, axis=0)
    return {
        "memory_mb": round(
            statistics.median(use.memory_mb for life in lives for _, use in life), 1
        ),
        "mb_per_h": round(statistics.median(slopes), 2),
        "handles": float(handles),
        "threads": float(threads),
        "hours": round(sum(life[-1][0] - life[0][0] for life in lives) / 3600.0, 2),
    }


def early_late(series: list[float]) -> tuple[float, float]:
    """Medians of the first and the last quarter."""
    quarter = max(1, len(series) // QUARTERS)
    return statistics.median(series[:quarter]), statistics.median(series[-quarter:])
