r"""Cost of the bus: codec, latency of each message,
the way from an image to the heightmap made of it.

Every sender publishes at 100 Hz from a process of its own; latency is the monotonic time from
before `put` to after `wait`, so it holds encoding, one hop of TCP, the receiver's waking up and
decoding.

Frame to heightmap: a robot's process and the heightmap service, linked directly as in a stack;
beside them a consumer that takes heightmaps at a quarter of the rate. Images are sent at fixed
times, whether answers have come or not. An image counts from before it is published to after the
heightmap made of it was taken; one whose heightmap never came, or came after that of a later image,
counts as unanswered and as infinitely late. State to heightmap counts from before the state is
published, which follows its image. 60,000 images take ten minutes.

    saltus bench transport -- --count 6000 --robots 8

An idle processor sleeps, and waking it is a good part of what is measured. To measure without
(root, bash):

    exec 3<>/dev/cpu_dma_latency; printf '\0\0\0\0' >&3; saltus bench transport
"""

import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
import timeit
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._command import Command
from benchmarks._measuring import percentiles, processor_s, random_frames, resident_mb
from saltus.arrays import Floats
from saltus.config import RunConfig
from saltus.depth import D435I
from saltus.depth_camera import SHIPPED
from saltus.grid import load_grid
from saltus.heightmap.level_robot import LevelRobot
from saltus.named_setup import named_setup
from saltus.plan import REST, plan_message
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.runtime.child import ENVIRONMENT
from saltus.runtime.process import PEER_FLAG
from saltus.runtime.run_folder import write_run
from saltus.runtime.ticker import Ticker
from saltus.states import standing_state
from saltus.wire.bus import Bell
from saltus.wire.codec import decode_message, encode_message
from saltus.wire.messages import (
    DepthFrame,
    Heightmap,
    HeightmapStatus,
    Message,
    PlanStatus,
    ProcessStatus,
    RobotState,
)
from saltus.wire.router import open_router
from saltus.wire.zenoh_bus import ZenohBus

PREFIX = "bench"
RATE_HZ = 100.0
WARM_UP = 20
REPEATS = 7
NUMBER = 300
SLOWER = 4  # times the period of the slow consumer
SETTLE = 500  # the first 5 s do not count
SCENES = 20
READY_S = 60.0
PATIENCE = 0.95  # of a period: until then answers are awaited before the next images are sent
EDGES_MS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0)
"""Upper edges of the histogram.

A last count is of what is later than all of them, or unanswered.
"""
SPAWN = multiprocessing.get_context("spawn")


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    messages: int = 1000
    """Messages of each topic."""
    count: int = 60_000
    """Images of each robot; the first 500 do not count."""
    robots: int = 1
    """Whom one service answers."""
    echo: bool = False
    """In place of the service a process that answers one robot with heights that it has: what bus,
    codec and waking up take by themselves."""

    def measure(self) -> dict[str, Any]:
        endpoint, router = open_router()
        with closing(router):
            table = {
                name: self._topic(endpoint, name, message)
                for name, message in sample_messages().items()
            }
        return {**frame_to_heightmap(self.count, self.robots, self.echo), "transport": table}

    def _topic(self, endpoint: str, topic: str, message: Message) -> dict[str, float]:
        data, kind = encode_message(message), type(message)
        times = latencies_ms(endpoint, endpoint, topic, self.messages, peer=True)
        latency = percentiles(times)
        return {
            "bytes": len(data),
            "encode_us": round(microseconds(lambda: encode_message(message)), 1),
            "decode_us": round(microseconds(lambda: decode_message(kind, data)), 1),
            "latency_p50_ms": latency["p50"],
            "latency_p99_ms": latency["p99"],
            "received": len(times) + WARM_UP,
            "sent": self.messages,
        }


def sample_messages() -> dict[str, Message]:
    """One message a topic, in the sizes that travel."""
    frame = random_frames(D435I, 1, np.random.default_rng(0))[0]
    plan = plan_message(REST, PlanStatus.GO)
    return {
        "policy/plan": plan,
        "controller/state": standing_state(load_robot(DEFAULT_ROBOT)),
        "camera/depth": frame,
    }


def send(endpoint: str, topic: str, count: int, peer: bool) -> None:
    """The sending process."""
    message = sample_messages()[topic]
    ticker = Ticker(RATE_HZ)
    with ZenohBus(endpoint, PREFIX, peer=peer) as bus:
        publisher = bus.publisher(topic)
        for _ in range(count):
            ticker.wait()
            publisher.put(replace(message, time_ns=time.monotonic_ns()))


def latencies_ms(sends: str, receives: str, topic: str, count: int, *, peer: bool) -> list[float]:
    """Receives what another process sends; each joins with an endpoint of its own."""
    sender = SPAWN.Process(target=send, args=(sends, topic, count, peer))
    times: list[float] = []
    with ZenohBus(receives, PREFIX, peer=peer) as bus:
        latest = bus.latest(topic)
        sender.start()
        while sender.is_alive():
            sample = latest.wait(0.1)
            if sample is not None:
                times.append(1e-6 * (time.monotonic_ns() - sample.message.time_ns))
    sender.join()
    return times[WARM_UP:]


class Scenes:
    """Images of a robot that stands, and its states."""

    def __init__(self) -> None:
        self._frames = random_frames(SHIPPED["d435i"].image, SCENES, np.random.default_rng(0))
        self._state = LevelRobot().states(load_robot(DEFAULT_ROBOT), self._frames[:1])[0]

    def at(self, number: int, time_ns: int) -> tuple[DepthFrame, RobotState]:
        """Both with the same number and time,
        so that a heightmap is due that is made of this image.
        """
        frame = replace(self._frames[number % SCENES], frame_id=number, time_ns=time_ns)
        return frame, replace(self._state, step=number, time_ns=time_ns)


class BusRobot:
    """A robot's place on the bus: sends images and states, receives heightmaps."""

    def __init__(self, endpoint: str, prefix: str, count: int, bell: Bell) -> None:
        self.bus = ZenohBus(endpoint, prefix, peer=True, bell=bell)
        self.latency_ms: Floats = np.full((2, count), np.inf)
        """From an image, and from the state that was sent after it,
        to its heightmap, shape (2, count)."""
        self.newest = -1
        """The image of the newest heightmap."""
        self._sent_ns = np.zeros((2, count), np.int64)
        self._frames, self._states = (
            self.bus.publisher("camera/depth"),
            self.bus.publisher("controller/state"),
        )
        self._heightmaps = self.bus.latest("heightmap/heightmap")

    def send(self, frame: DepthFrame, state: RobotState) -> None:
        """Publishes both."""
        self._sent_ns[0, frame.frame_id] = time.monotonic_ns()
        self._frames.put(frame)
        self._sent_ns[1, frame.frame_id] = time.monotonic_ns()
        self._states.put(state)

    def receive(self) -> None:
        """Takes a heightmap, if one has come."""
        sample = self._heightmaps.take()
        if sample is not None and sample.message.frame_id > self.newest:
            self.newest = sample.message.frame_id
            since_ns = time.monotonic_ns() - self._sent_ns[:, self.newest]
            self.latency_ms[:, self.newest] = 1e-6 * since_ns


def run_robots(
    endpoint: str, prefixes: list[str], epoch_ns: int, count: int, newest: Any, result: Any
) -> None:
    """The process of the robots: tells the newest heightmap of the first,
    and at last all latencies [ms].
    """
    os.environ.update(ENVIRONMENT)
    scenes, bell = Scenes(), Bell()
    robots = [BusRobot(endpoint, prefix, count, bell) for prefix in prefixes]
    ticker = Ticker(RATE_HZ)
    for number in range(count):
        ticker.wait()
        patience_end_s = time.monotonic() + PATIENCE / RATE_HZ
        message = scenes.at(number, time.monotonic_ns() - epoch_ns)
        for robot in robots:
            robot.send(*message)
        while (left_s := patience_end_s - time.monotonic()) > 0.0:
            heard = bell.rings
            for robot in robots:
                robot.receive()
            newest.value = robots[0].newest
            if all(robot.newest == number for robot in robots):
                break
            bell.wait(heard, left_s)
    latency_ms = np.concatenate([robot.latency_ms[:, SETTLE:] for robot in robots], axis=1)
    result.send((latency_ms, ticker.overruns))
    for robot in robots:
        robot.bus.close()


def answer_at_once(endpoint: str, prefix: str) -> None:
    """The process that stands in for the service: it takes the same and says as much."""
    line = load_grid("line")
    answer = Heightmap(
        time_ns=0, step=0, x=np.array(line.x), height=np.zeros(30), half_width_90=np.ones(30),
        status=HeightmapStatus.OK, depth_age_s=0.0, frame_id=0, model_id="0" * 16,
    )  # fmt: skip
    with ZenohBus(endpoint, prefix, peer=True) as bus:
        frames, states = bus.latest("camera/depth", rings=False), bus.latest("controller/state")
        answers, status = bus.publisher("heightmap/heightmap"), bus.publisher("status", "heightmap")
        status.put(ProcessStatus(time_ns=0, process="heightmap", ready=True, ticks=0, overruns=0))
        while True:
            asked = states.wait(1.0)
            if asked is not None and frames.take() is not None:
                step, time_ns = asked.message.step, asked.message.time_ns
                answers.put(replace(answer, time_ns=time_ns, step=step, frame_id=step))


def run_slow_consumer(
    endpoint: str, prefix: str, epoch_ns: int, newest: Any, over: Any, result: Any
) -> None:
    """Takes heightmaps at a quarter of the rate and any phase:
    age [ms], and how many newer ones there were already.
    """
    rng, ages, behind = np.random.default_rng(0), [], []
    ticker = Ticker(RATE_HZ / SLOWER)
    with ZenohBus(endpoint, prefix, peer=True) as bus:
        heightmaps = bus.latest("heightmap/heightmap")
        while not over.is_set():
            ticker.wait()
            time.sleep(rng.uniform(0.0, 1.0 / RATE_HZ))
            known = newest.value
            sample = heightmaps.take()
            if sample is not None and sample.message.frame_id >= SETTLE:
                ages.append(1e-6 * (time.monotonic_ns() - epoch_ns - sample.message.time_ns))
                behind.append(known - sample.message.frame_id)
    result.send((ages, behind))


def frame_to_heightmap(count: int, robots: int, echo: bool) -> dict[str, Any]:
    """Runs robots, service and slow consumer, and returns the table of the benchmark.

    Args:
        count: Images of each robot.
        robots: How many one service answers.
        echo: Whether nothing is computed for the answers.
    """
    prefixes = [f"bench/{i}" for i in range(robots)]
    load = os.getloadavg()[0]
    config = RunConfig(
        robot="go1", grid="line", prefix=prefixes[0], pace="realtime", epoch_ns=time.monotonic_ns()
    )
    with served(config, prefixes, echo) as (endpoint, service):
        (latency, answer), overruns, ages, behind, share, memory_mb = _watched(
            service, endpoint, prefixes, config.epoch_ns, count
        )
    edges = np.array([0.0, *EDGES_MS, np.inf])
    histogram = np.histogram(np.where(np.isfinite(latency), latency, np.finfo(float).max), edges)[0]
    return {
        "frame_to_heightmap_ms": percentiles(latency, method="higher"),
        "state_to_heightmap_ms": percentiles(answer, method="higher"),
        "slow_consumer_age_ms": {
            "max": round(max(ages), 2),
            "p50": round(float(np.median(ages)), 2),
        },
        "slow_consumer_frames_behind": {"max": max(behind)},
        "samples": len(latency),
        "unanswered": int(np.sum(~np.isfinite(latency))),
        "sender_overruns": overruns,
        "histogram": {"edges_ms": list(EDGES_MS), "counts": histogram.tolist()},
        "robots": robots,
        "service_core_share": round(share, 3),
        "service_rss_mb": round(memory_mb),
        "load": round(load, 1),
        "cpu_dma_latency_us": allowed_latency_us(),
    }


@contextmanager
def served(config: RunConfig, prefixes: list[str], echo: bool = False) -> Iterator[tuple[str, int]]:
    """A router and one heightmap service for these robots, or `answer_at_once`:
    the router's endpoint, and the service's process id.

    `config` is of a run that has begun; its prefix is one of them.
    """
    endpoint, router = open_router()
    with (
        closing(router),
        tempfile.TemporaryDirectory() as directory,
        ZenohBus(endpoint, config.prefix, peer=True) as bus,
    ):
        write_run(Path(directory), config, named_setup(config))
        status = bus.latest("status", "heightmap")
        arguments = [
            "--run-dir",
            directory,
            "--endpoint",
            endpoint,
            PEER_FLAG,
            "--robots",
            *prefixes,
        ]
        environment = {**os.environ, **ENVIRONMENT}
        program = ["-m", "saltus.heightmap", *arguments]
        if echo:
            call = f"answer_at_once({endpoint!r}, {config.prefix!r})"
            program = ["-c", f"from benchmarks.transport import answer_at_once; {call}"]
        service = subprocess.Popen([sys.executable, *program], env=environment)
        try:
            if status.wait(READY_S) is None:
                raise RuntimeError("the heightmap service is not ready")
            yield endpoint, service.pid
        finally:
            service.terminate()
            service.wait()


def allowed_latency_us() -> int | None:
    """Time that processors of this machine may take to wake [us]:
    the kernel's PM QoS; None where nobody may tell.
    """
    try:
        return int.from_bytes(
            Path("/dev/cpu_dma_latency").read_bytes()[:4], sys.byteorder, signed=True
        )
    except OSError:
        return None


def _watched(
    pid: int, endpoint: str, prefixes: list[str], epoch_ns: int, count: int
) -> tuple[Floats, int, list[float], list[int], float, float]:
    """Latencies [ms] and overruns of the sender,
    ages [ms] and lags of the consumer, core share and MB of service.
    """
    newest, over = SPAWN.Value("q", -1), SPAWN.Event()
    robots_end, robots_result = SPAWN.Pipe(duplex=False)
    consumer_end, consumer_result = SPAWN.Pipe(duplex=False)
    robots = SPAWN.Process(
        target=run_robots, args=(endpoint, prefixes, epoch_ns, count, newest, robots_result)
    )
    consumer = SPAWN.Process(
        target=run_slow_consumer,
        args=(endpoint, prefixes[0], epoch_ns, newest, over, consumer_result),
    )
    start_s, before_s = time.monotonic(), processor_s([pid])
    robots.start()
    consumer.start()
    latency, overruns = robots_end.recv()
    share = (processor_s([pid]) - before_s) / (time.monotonic() - start_s)
    memory_mb = resident_mb([pid])
    over.set()
    ages, behind = consumer_end.recv()
    robots.join()
    consumer.join()
    return latency, overruns, ages, behind, share, memory_mb


def microseconds(call: Callable[[], object]) -> float:
    """Median over repeats of the mean time of a call."""
    return float(np.median(timeit.repeat(call, number=NUMBER, repeat=REPEATS))) / NUMBER * 1e6
