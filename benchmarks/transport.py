r"""What the bus costs: codec times, latency of each message, and the way from an image to the heightmap made of it.

    saltus bench transport --json [--arguments=--count --arguments=6000] [--arguments=--robots --arguments=8]

Every sender publishes at 100 Hz from a process of its own; latency is the monotonic time from before `put` to after
`wait`, so it holds encoding, one hop of TCP, the receiver's waking up and decoding.

Frame to heightmap: a robot's process and the heightmap service, linked directly as in a stack; beside them a consumer
that takes heightmaps at a quarter of the rate. Sending goes by absolute deadlines, whatever becomes of the answers. An
image counts from before it is published to after the heightmap made of it was taken; one whose heightmap never came, or
came after that of a later image, counts as unanswered and as infinitely late. 60,000 images take ten minutes. Prints
one JSON object last.

An idle processor sleeps, and waking it is a good part of what is measured. To measure without (root, bash):

    exec 3<>/dev/cpu_dma_latency; printf '\0\0\0\0' >&3; saltus bench transport --json
"""

import argparse
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
import timeit
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from saltus.action import REST, plan_message
from saltus.cli.output import print_json
from saltus.config import RunConfig, to_toml
from saltus.depth import MILLIMETRE
from saltus.heightmap.service.replay import AssumeLevel
from saltus.render.stereo.model_view import sampled_model_camera
from saltus.runtime.child import ENVIRONMENT
from saltus.runtime.process import PEER_FLAG, RUN_FILE
from saltus.runtime.stack import open_router
from saltus.runtime.ticker import Ticker
from saltus.states import standing_state
from saltus.wire.bus import Bell
from saltus.wire.codec import decode, encode
from saltus.wire.messages import DepthFrame, Floats, Message, PlanStatus, RobotState
from saltus.wire.zenoh_bus import ZenohBus

PREFIX = "bench"
RATE_HZ = 100.0
WARM_UP = 20
REPEATS = 7
NUMBER = 300
SLOWER = 4  # times the period of the slow consumer
SETTLE = 500  # the first 5 s do not count
NATIVE_PIXELS = 5  # of the D435i for one pixel of the model: its centre crop of 80x240, as the stack sends it
SCENES = 20
READY_S = 60.0
PATIENCE = 0.95  # of a period: until then answers are awaited before the next images are sent
EDGES_MS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0)
"""Upper edges of the histogram; a last count is of what is later than all of them, or unanswered."""
SPAWN = multiprocessing.get_context("spawn")


def sample_messages() -> dict[str, Message]:
    """One message a topic, in the sizes that travel."""
    depth = np.random.default_rng(0).integers(0, 3000, (240, 424), dtype=np.uint16)
    frame = DepthFrame(time_ns=0, frame_id=0, depth=depth, depth_unit_m=0.001, fx=213.0, fy=213.0, cx=212.0, cy=120.0)
    state = standing_state()
    plan = plan_message(REST, PlanStatus.GO)
    return {"policy/plan": plan, "controller/state": state, "camera/depth": frame}


def send(endpoint: str, topic: str, count: int) -> None:
    """The sending process."""
    message = sample_messages()[topic]
    ticker = Ticker(RATE_HZ)
    with ZenohBus(endpoint, PREFIX, peer=True) as bus:
        publisher = bus.publisher(topic)
        for _ in range(count):
            ticker.wait()
            publisher.put(replace(message, time_ns=time.monotonic_ns()))


def latencies_ms(endpoint: str, topic: str, count: int) -> list[float]:
    """Receives what another process sends."""
    sender = SPAWN.Process(target=send, args=(endpoint, topic, count))
    times: list[float] = []
    with ZenohBus(endpoint, PREFIX, peer=True) as bus:
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
        camera = sampled_model_camera(NATIVE_PIXELS, NATIVE_PIXELS)
        size = SCENES, camera.height, camera.width
        self._depth = np.random.default_rng(0).integers(300, 2500, size).astype(np.uint16)
        self._frame = DepthFrame(
            time_ns=0,
            frame_id=0,
            depth=self._depth[0],
            depth_unit_m=MILLIMETRE,
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx,
            cy=camera.cy,
        )
        self._state = AssumeLevel().states([self._frame])[0]

    def at(self, number: int, time_ns: int) -> tuple[DepthFrame, RobotState]:
        """Both with the same number and time, so that a heightmap is due that is made of this image."""
        frame = replace(self._frame, frame_id=number, time_ns=time_ns, depth=self._depth[number % SCENES])
        return frame, replace(self._state, step=number, time_ns=time_ns)


class Robot:
    """A robot's place on the bus: sends images and states, receives heightmaps."""

    def __init__(self, endpoint: str, prefix: str, count: int, bell: Bell) -> None:
        self.bus = ZenohBus(endpoint, prefix, peer=True, bell=bell)
        self.latency_ms: Floats = np.full(count, np.inf)
        self.newest = -1
        """The image of the newest heightmap."""
        self._sent_times = np.zeros(count, np.int64)
        self._frames, self._states = self.bus.publisher("camera/depth"), self.bus.publisher("controller/state")
        self._heightmaps = self.bus.latest("heightmap/heightmap")

    def send(self, frame: DepthFrame, state: RobotState) -> None:
        """Publishes both."""
        self._sent_times[frame.frame_id] = time.monotonic_ns()
        self._frames.put(frame)
        self._states.put(state)

    def receive(self) -> None:
        """Takes a heightmap, if one has come."""
        sample = self._heightmaps.take()
        if sample is not None and sample.message.frame_id > self.newest:
            self.newest = sample.message.frame_id
            self.latency_ms[self.newest] = 1e-6 * (time.monotonic_ns() - self._sent_times[self.newest])


def run_robots(endpoint: str, prefixes: list[str], epoch_ns: int, count: int, newest: Any, result: Any) -> None:
    """The process of the robots: tells the newest heightmap of the first, and at last all latencies [ms]."""
    os.environ.update(ENVIRONMENT)
    scenes, bell = Scenes(), Bell()
    robots = [Robot(endpoint, prefix, count, bell) for prefix in prefixes]
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
    result.send((np.concatenate([robot.latency_ms[SETTLE:] for robot in robots]), ticker.overruns))
    for robot in robots:
        robot.bus.close()


def run_slow_consumer(endpoint: str, prefix: str, epoch_ns: int, newest: Any, over: Any, result: Any) -> None:
    """Takes heightmaps at a quarter of the rate and any phase: age [ms], and how many newer ones there were already."""
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


def frame_to_heightmap(count: int, robots: int) -> dict[str, Any]:
    """Runs robots, service and slow consumer, and returns the table of the benchmark.

    Args:
        count: Images of each robot.
        robots: How many one service answers.
    """
    prefixes = [f"bench/{i}" for i in range(robots)]
    epoch_ns, load = time.monotonic_ns(), os.getloadavg()[0]
    endpoint, router = open_router()
    with (
        closing(router),
        tempfile.TemporaryDirectory() as directory,
        ZenohBus(endpoint, prefixes[0], peer=True) as bus,
    ):
        config = RunConfig(prefix=prefixes[0], pace="realtime", epoch_ns=epoch_ns)
        (Path(directory) / RUN_FILE).write_text(to_toml(config))
        status = bus.latest("status", "heightmap")
        arguments = ["--run-dir", directory, "--endpoint", endpoint, PEER_FLAG, "--robots", *prefixes]
        environment = {**os.environ, **ENVIRONMENT}
        service = subprocess.Popen([sys.executable, "-m", "saltus.heightmap", *arguments], env=environment)
        try:
            if status.wait(READY_S) is None:
                raise RuntimeError("the heightmap service is not ready")
            latency, overruns, ages, behind, share, memory = _watched(service.pid, endpoint, prefixes, epoch_ns, count)
        finally:
            service.terminate()
            service.wait()
    edges = np.array([0.0, *EDGES_MS, np.inf])
    histogram = np.histogram(np.where(np.isfinite(latency), latency, np.finfo(float).max), edges)[0]
    p50, p99 = np.percentile(latency, [50, 99], method="higher")
    return {
        "frame_to_heightmap_ms": {"p50": round(float(p50), 3), "p99": round(float(p99), 3)},
        "slow_consumer_age_ms": {"max": round(max(ages), 2), "p50": round(float(np.median(ages)), 2)},
        "slow_consumer_frames_behind": {"max": max(behind)},
        "samples": len(latency),
        "unanswered": int(np.sum(~np.isfinite(latency))),
        "sender_overruns": overruns,
        "histogram": {"edges_ms": list(EDGES_MS), "counts": histogram.tolist()},
        "robots": robots,
        "service_core_share": round(share, 3),
        "service_rss_mb": round(1e-6 * memory),
        "load": round(load, 1),
        "cpu_dma_latency_us": allowed_latency_us(),
    }


def allowed_latency_us() -> int | None:
    """How long processors of this machine may take to wake [us]: the kernel's PM QoS; None where nobody may tell."""
    try:
        return int.from_bytes(Path("/dev/cpu_dma_latency").read_bytes()[:4], sys.byteorder, signed=True)
    except OSError:
        return None


def _watched(
    pid: int, endpoint: str, prefixes: list[str], epoch_ns: int, count: int
) -> tuple[Floats, int, list[float], list[int], float, int]:
    """Latencies [ms], overruns of the sender, ages [ms] and lags of the consumer, core share and RSS of the service."""
    newest, over = SPAWN.Value("q", -1), SPAWN.Event()
    robots_end, robots_result = SPAWN.Pipe(duplex=False)
    consumer_end, consumer_result = SPAWN.Pipe(duplex=False)
    robots = SPAWN.Process(target=run_robots, args=(endpoint, prefixes, epoch_ns, count, newest, robots_result))
    consumer = SPAWN.Process(
        target=run_slow_consumer, args=(endpoint, prefixes[0], epoch_ns, newest, over, consumer_result)
    )
    service, start_s = psutil.Process(pid), time.monotonic()
    before = service.cpu_times()
    robots.start()
    consumer.start()
    latency, overruns = robots_end.recv()
    after = service.cpu_times()
    share = (after.user + after.system - before.user - before.system) / (time.monotonic() - start_s)
    memory = service.memory_info().rss
    over.set()
    ages, behind = consumer_end.recv()
    robots.join()
    consumer.join()
    return latency, overruns, ages, behind, share, memory


def microseconds(call: Callable[[], object]) -> float:
    """Median over repeats of the mean time of a call."""
    return float(np.median(timeit.repeat(call, number=NUMBER, repeat=REPEATS))) / NUMBER * 1e6


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--messages", type=int, default=1000, help="messages of each topic")
    parser.add_argument("--count", type=int, default=60_000, help="images of each robot")
    parser.add_argument("--robots", type=int, default=1, help="whom one service answers")
    options = parser.parse_args()
    endpoint, router = open_router()
    table = {}
    for topic, message in sample_messages().items():
        data, kind = encode(message), type(message)
        times = latencies_ms(endpoint, topic, options.messages)
        p50, p99 = np.percentile(times, [50, 99])
        table[topic] = {
            "bytes": len(data),
            "encode_us": round(microseconds(lambda m=message: encode(m)), 1),  # type: ignore[misc]
            "decode_us": round(microseconds(lambda k=kind, d=data: decode(k, d)), 1),  # type: ignore[misc]
            "latency_p50_ms": round(float(p50), 3),
            "latency_p99_ms": round(float(p99), 3),
            "received": len(times) + WARM_UP,
            "sent": options.messages,
        }
    router.close()
    print_json({**frame_to_heightmap(options.count, options.robots), "transport": table})


if __name__ == "__main__":
    main()
