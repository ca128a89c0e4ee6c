"""A link between robot and heightmap service that holds what it is given,
or is slow, and delivers it later.
"""

import contextlib
import math
import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from heightmap_inputs import on_time, states
from samples import put_run

from saltus.clock import RunClock
from saltus.config import RunConfig
from saltus.heightmap.service.process import HeightmapProcess
from saltus.runtime.process import ProcessContext
from saltus.wire.bus import topic_of, unpack_sample
from saltus.wire.joining import LOCAL
from saltus.wire.messages import Heightmap, HeightmapStatus
from saltus.wire.router import open_router
from saltus.wire.topics import TOPICS
from saltus.wire.zenoh_bus import ZenohBus

SPEED = 0.5
TICK_NS = 10_000_000
BEFORE, AFTER = 40, 80  # ticks
ANSWERED_S = 0.5
"""Older states are not answered."""
TIMEOUT_S = 10.0


class Relay:
    """Passes on what comes to a socket of its own, both ways."""

    def __init__(self, folder: Path, endpoint: str) -> None:
        self.endpoint = f"{LOCAL}{folder / 'relay'}"
        self.rate = math.inf
        """Bytes a second, each way; 0 holds them."""
        self._router = endpoint.removeprefix(LOCAL)
        self._ear = socket.socket(socket.AF_UNIX)
        self._ear.bind(str(folder / "relay"))
        self._ear.listen()
        self._sockets = [self._ear]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # closed
            while True:
                near, far = self._ear.accept()[0], socket.socket(socket.AF_UNIX)
                far.connect(self._router)
                self._sockets += [near, far]
                for source, target in ((near, far), (far, near)):
                    threading.Thread(
                        target=self._pass_on, args=(source, target), daemon=True
                    ).start()

    def _pass_on(self, source: socket.socket, target: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                while not self.rate:
                    time.sleep(0.001)
                time.sleep(len(data) / self.rate)
                target.sendall(data)

    def close(self) -> None:
        """Ends all that goes through it."""
        self.rate = math.inf
        for each in self._sockets:
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()


@pytest.fixture
def service(model_path: Path, tmp_path: Path) -> Iterator[tuple[str, RunClock]]:
    """The router of a heightmap service, and the run's clock."""
    config = RunConfig(
        robot="go1",
        grid="line",
        pace="realtime",
        speed=SPEED,
        heightmap_model=str(model_path),
        epoch_ns=time.monotonic_ns(),
    )
    endpoint, router = open_router()
    with contextlib.closing(router), ZenohBus(endpoint, config.prefix) as bus:
        context = ProcessContext("heightmap", config, put_run(tmp_path, config), bus)
        thread = threading.Thread(
            target=HeightmapProcess([context]).run, args=(lambda: context.stopped,)
        )
        thread.start()
        yield endpoint, RunClock.of(config)
        context.stopped = True
        thread.join(TIMEOUT_S)
        assert not thread.is_alive()


@pytest.mark.parametrize(
    ("held", "rate"),
    [(10, 0.0), (80, 0.0), (40, 5e3)],
    ids=["late", "until the link is given up", "slow"],
)
def test_what_a_link_held_has_no_effect_and_heights_are_soon_good_again(
    held: int, rate: float, service: tuple[str, RunClock]
) -> None:
    endpoint, clock = service
    captured_ns: dict[int, int] = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.closing(Relay(Path(folder), endpoint)) as relay,
        ZenohBus(endpoint, "robot/0") as observer,
        ZenohBus(relay.endpoint, "robot/0") as robot,
    ):
        heard = observer.stream()
        state_out, frame_out = robot.publisher("controller/state"), robot.publisher("camera/depth")
        until_s = time.monotonic() + TIMEOUT_S
        while not (state_out.heard() and frame_out.heard()):
            assert time.monotonic() < until_s
            time.sleep(0.01)
        first_ns = clock.now_ns()
        for state in states(BEFORE + held + AFTER):
            if state.step == BEFORE:
                relay.rate = rate
            if state.step == BEFORE + held:
                relay.rate = math.inf
                released_ns = clock.now_ns()
            time.sleep(
                max(0.0, clock.machine_s(1e-9 * (first_ns + state.step * TICK_NS - clock.now_ns())))
            )
            now_ns, frame = clock.now_ns(), on_time(state.step)
            if frame is not None:
                captured_ns[frame.frame_id] = now_ns - 5 * TICK_NS
                frame_out.put(replace(frame, time_ns=captured_ns[frame.frame_id]))
            state_out.put(replace(state, time_ns=now_ns))
        time.sleep(clock.machine_s(0.1))
        answers: list[tuple[int, Heightmap]] = []
        for raw in heard.drain():
            topic = topic_of(raw.key)
            message = unpack_sample(topic, raw)[1] if topic is not None else None
            if isinstance(message, Heightmap):
                answers.append((clock.of_monotonic(raw.arrival_ns), message))
    depth = TOPICS["camera/depth"]
    assert (
        max(1e-9 * (arrival_ns - answer.time_ns) for arrival_ns, answer in answers)
        < 1.1 * ANSWERED_S
    )
    for _, answer in answers:
        if answer.frame_id >= 0:
            assert answer.depth_age_s == pytest.approx(
                1e-9 * (answer.time_ns - captured_ns[answer.frame_id])
            )
        if answer.status == HeightmapStatus.OK:
            assert answer.depth_age_s <= depth.degraded_age_s
    steps = [answer.step for _, answer in answers]
    assert steps == sorted(steps)
    assert sum(BEFORE <= step < BEFORE + held for step in steps) < held  # the link was in the way
    before = [answer.status for _, answer in answers if answer.step < BEFORE]
    after = [answer for arrival_ns, answer in answers if arrival_ns > released_ns]
    assert HeightmapStatus.OK in before
    assert HeightmapStatus.OK in [answer.status for answer in after]
    assert (
        min(captured_ns[a.frame_id] for a in after if a.status == HeightmapStatus.OK)
        > released_ns - 20 * TICK_NS
    )
