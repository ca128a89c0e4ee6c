"""Malformed messages of many kinds on every key that a process subscribes to:
it lives on and counts each of them.
"""

import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from samples import message_of

from saltus.clock import RunClock
from saltus.config import RunConfig, TerrainConfig
from saltus.named_setup import named_setup
from saltus.resources import shipped_file
from saltus.runtime.programs import PROGRAMS
from saltus.runtime.run_folder import write_run
from saltus.wire import codec, schemas
from saltus.wire.bus import Latest
from saltus.wire.codec import Envelope
from saltus.wire.messages import Done, Message, MotionPlan, PlanStatus, RobotState
from saltus.wire.router import open_router
from saltus.wire.topics import TOPICS
from saltus.wire.zenoh_bus import ZenohBus

HERE = Path(__file__).parent
READY_S = 60.0
COUNTED_S = 20.0
BATCH = 4  # at a time, well below what a ring keeps
TRIGGER_S = 0.05

SUBSCRIBED = {
    "render": ("plant/truth",),
    "heightmap": ("controller/state", "camera/depth"),
    "policy": ("controller/state", "heightmap/heightmap"),
    "controller": ("policy/plan",),
    "consumer": tuple(name for name, topic in TOPICS.items() if topic.publisher != "*"),
}
"""What each process takes in real time."""
MODULES = {program.name: program.module for program in PROGRAMS}


@dataclass(frozen=True)
class Malformed:
    """Bytes that must be refused, and the reason that they must be counted under."""

    reason: str
    payload: bytes
    attachment: bytes


def malformed(kind: type[Message], boot_id: bytes, time_ns: int) -> Iterator[Malformed]:
    """At least 20 kinds of malformed messages of one type."""
    message = replace(message_of(kind), time_ns=time_ns)
    good = codec.encode_message(message)
    envelope = Envelope(10**6, time_ns, boot_id).to_bytes()
    # Done could be taken for a command, up to its mode
    other: Any = Done if kind is RobotState else RobotState
    payloads = {
        "empty": [b""],
        "size": [bytes(codec.PAYLOAD_MAX + 1)],
        "malformed": [
            b"\0",
            good[:4],
            good[: len(good) // 2],
            good[:-1],
            good + b"\0",
            b"\0\0" + good[2:],  # big-endian
            b"\xff" * len(good),
            b'{"hello": "world"}',
            good[:4] + np.random.default_rng(0).bytes(len(good)),
            good[:12] + b"\xff\xff\xff\xff" + good[16:],  # a text of 4 GiB
            codec.encode_message(message_of(other)),
            good[: len(good) // 2] + good[len(good) // 2 + 8 :],
        ],
        "range": [good[:8] + b"\xff\xff\xff\x7f" + good[12:]],  # two seconds' worth of nanoseconds
    }
    for reason, candidates in payloads.items():
        for payload in candidates:
            yield Malformed(reason, payload, envelope)
    name = "depth_unit_m" if kind is schemas.messages.DepthFrame else first_float(kind)
    for reason, value in (("not_finite", np.nan), ("not_finite", -np.inf), ("range", 1e300)):
        value = (
            value
            if np.isscalar(getattr(message, name))
            else np.full_like(getattr(message, name), value)
        )
        yield Malformed(reason, codec.encode_message(replace(message, **{name: value})), envelope)
    for attachment in (
        b"",
        envelope[:-1],
        envelope + b"\0",
        Envelope(0, time_ns, boot_id).to_bytes(),
    ):
        yield Malformed("envelope", good, attachment)
    yield Malformed("capture_time", good, Envelope(10**6, time_ns + 1, boot_id).to_bytes())


def first_float(kind: type[Message]) -> str:
    return next(field.name for field in schemas.FIELDS[kind] if field.wire == "float64")


class Victim:
    """A real process on a prefix of its own, fed by nobody but the test."""

    def __init__(self, name: str, endpoint: str, directory: Path, speed: float) -> None:
        self.name = name
        self.prefix = f"victim/{name}"
        directory.mkdir()
        self.step = 0
        config = RunConfig(
            robot="go1",
            grid="line",
            prefix=self.prefix,
            pace="realtime",
            time_limit_s=600.0,
            epoch_ns=time.monotonic_ns(),
            terrain=TerrainConfig(terrain="flat"),
            speed=speed,
        )
        self.clock = RunClock.of(config)
        write_run(directory, config, named_setup(config))
        self.bus = ZenohBus(endpoint, self.prefix)
        self.status = self.bus.latest("status", name)
        self.triggers = {topic: self.bus.publisher(topic) for topic in SUBSCRIBED[name]}
        self.log = directory / "log"
        with self.log.open("wb") as file:
            command = [sys.executable, "-P", "-m", MODULES.get(name, name)]
            self.process = subprocess.Popen(
                [*command, "--run-dir", str(directory), "--endpoint", endpoint],
                stdout=file,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PYTHONPATH": str(HERE), "OMP_NUM_THREADS": "1"},
            )

    def trigger(self) -> None:
        """Good messages on every key: some processes look
        at one topic only when another has come.
        """
        self.step += 1
        for topic, publisher in self.triggers.items():
            message = replace(message_of(TOPICS[topic].message), time_ns=self.clock.now_ns())
            if isinstance(
                message, MotionPlan
            ):  # on a drawn plan a robot falls, and its run is over
                message = replace(message, status=PlanStatus.STAND)
            publisher.put(message if topic == "camera/depth" else replace(message, step=self.step))  # type: ignore[call-arg]

    def counted(self, latest: Latest) -> dict[str, int] | None:
        assert self.process.poll() is None, f"{self.name} died:\n{self.log.read_text()}"
        sample = latest.take()
        return None if sample is None else sample.message.rejected

    def close(self) -> None:
        """After it has been told to end."""
        try:
            self.process.wait(self.clock.machine_s(5.0))
        finally:
            self.process.kill()
            self.process.wait()
            self.bus.close()


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    endpoint, router = open_router()
    yield endpoint
    router.close()


@pytest.fixture(scope="module")
def victims(
    endpoint: str, first_speed: float, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[dict[str, Victim]]:
    """All processes at once: they load at the same time."""
    root = tmp_path_factory.mktemp("victims")
    victims = {name: Victim(name, endpoint, root / name, first_speed) for name in SUBSCRIBED}
    yield victims
    for victim in victims.values():
        victim.process.terminate()
    for victim in victims.values():
        victim.close()


@pytest.fixture(scope="module")
def attacker(endpoint: str) -> Iterator[Any]:
    settings = zenoh.Config.from_file(str(shipped_file("zenoh_cfg/client.json5")))
    settings.insert_json5("connect/endpoints", f'["{endpoint}"]')
    with zenoh.open(settings) as session:
        yield session


def test_every_malformed_message_is_counted_and_nobody_dies(
    victims: dict[str, Victim], attacker: Any
) -> None:
    for victim in victims.values():
        wait_until_ready(victim)
    attacks = [
        (
            victim,
            topic,
            list(malformed(TOPICS[topic].message, victim.bus.boot_id, victim.clock.now_ns())),
        )
        for victim in victims.values()
        for topic in SUBSCRIBED[victim.name]
    ]
    kinds = min(len(attack) for _, _, attack in attacks)
    assert kinds >= 20
    expected: dict[str, Counter[str]] = {name: Counter() for name in victims}
    for start in range(0, kinds, BATCH):
        for victim, topic, attack in attacks:
            for item in attack[start : start + BATCH]:
                # Behind the 5 MB of one of them a message that may be dropped would be: each must
                # arrive to be counted.
                block = zenoh.CongestionControl.BLOCK
                key = f"{victim.prefix}/{topic}"
                attacker.put(
                    key, item.payload, attachment=item.attachment, congestion_control=block
                )
                expected[victim.name][f"{topic}/{item.reason}"] += 1
        wait_until_counted(victims, expected)


def wait_until_ready(victim: Victim) -> None:
    deadline_s = victim.clock.elapsed_s() + READY_S
    while victim.status.wait(0.1) is None:
        dead = victim.process.poll() is not None
        assert not dead, f"{victim.name} died before it was ready:\n{victim.log.read_text()}"
        assert victim.clock.elapsed_s() < deadline_s, (
            f"{victim.name} is not ready:\n{victim.log.read_text()}"
        )


def wait_until_counted(victims: dict[str, Victim], expected: dict[str, Counter[str]]) -> None:
    """All at once: each says no more than twice a second what it has counted."""
    clock = next(iter(victims.values())).clock
    deadline_s = clock.elapsed_s() + COUNTED_S
    counted: dict[str, dict[str, int]] = {name: {} for name in victims}
    while counted != expected:
        assert clock.elapsed_s() < deadline_s, f"{counted} were counted instead of {expected}"
        for victim in victims.values():
            victim.trigger()
        time.sleep(clock.machine_s(TRIGGER_S))
        counted = {
            name: victim.counted(victim.status) or counted[name] for name, victim in victims.items()
        }
