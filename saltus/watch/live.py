"""A run that goes on, seen from its bus.

It listens only while somebody watches, and keeps the last seconds.
"""

import time
from collections import deque
from dataclasses import replace
from pathlib import Path

from saltus.clock import RunClock
from saltus.errors import MessageError
from saltus.recordings.recording import RecordedMessage
from saltus.runtime.run_folder import read_run
from saltus.watch.scene import LOOK_BACK_NS, Scene, SceneMaker, SceneWorld
from saltus.wire.bus import MessageStream, RawSample, topic_of, unpack_sample
from saltus.wire.codec import Envelope
from saltus.wire.messages import OPERATOR, Event
from saltus.wire.sharing import PERIOD_S, unpack_samples
from saltus.wire.zenoh_bus import ZenohBus

UNSHARED_NS = 1_000_000_000
"""Silence after which a reader listens for itself. A supervisor hands on each `PERIOD_S`, be it
nothing."""
WAITED_NS = round(2e9 * PERIOD_S)
"""A batch that is later than this is missed."""


class Onlooker:
    """All messages, as the supervisor of the robot hands them on.

    While there is none, it listens for itself.

    A supervisor that loads its processes hands on nothing for a second and more.

    Args:
        bus: Of the robot.
        capacity: Samples that may wait to be taken; what comes beyond is dropped.
    """

    def __init__(self, bus: ZenohBus, capacity: int) -> None:
        self._bus, self._capacity = bus, capacity
        self._shared = MessageStream(capacity)
        self._own: MessageStream | None = None
        self._heard_itself: dict[tuple[str, bytes], int] = {}
        """When it heard what it may be handed on as well [ns]."""
        self._heard_ns = time.monotonic_ns()
        bus.look_on(self._receive)

    def drain(self) -> list[RawSample]:
        """Messages since the last call, in order of arrival."""
        shared = self._shared.drain()
        if self._own is None:
            if time.monotonic_ns() - self._heard_ns > UNSHARED_NS:
                self._own = self._bus.stream(self._capacity)
            return self._unheard(shared)
        own = self._own.drain()
        if shared:
            self._own.end()
            own += self._own.drain()
            self._own = None
        since_ns = time.monotonic_ns() - UNSHARED_NS
        self._heard_itself = {
            heard: at_ns for heard, at_ns in self._heard_itself.items() if at_ns > since_ns
        }
        self._heard_itself |= {(raw.key, raw.attachment): raw.arrival_ns for raw in own}
        return own + self._unheard(shared)

    def heard_until_ns(self) -> int:
        """The time by this machine's monotonic clock until which it knows what was said:
        that of the newest batch.

        While no batches come, time goes on all the same, and what was said last grows old.
        """
        now_ns = time.monotonic_ns()
        return now_ns if self._own is not None else max(self._heard_ns, now_ns - WAITED_NS)

    def _unheard(self, shared: list[RawSample]) -> list[RawSample]:
        """Samples handed on that it has not heard itself.

        An attachment counts the messages of its sender.
        """
        if (
            self._heard_itself
            and shared
            and shared[0].arrival_ns > max(self._heard_itself.values()) + WAITED_NS
        ):
            self._heard_itself = {}
        return [raw for raw in shared if (raw.key, raw.attachment) not in self._heard_itself]

    def _receive(self, batch: bytes) -> None:
        self._heard_ns = time.monotonic_ns()
        for sample in unpack_samples(batch):
            self._shared.push(sample)


CAPACITY = 4000
"""Samples that may wait to be looked at, some seconds of a run.

What comes beyond is dropped here and slows nobody.
"""
EVENTS_KEPT = 200


class LiveRun:
    """Scenes of a run that goes on, as a context manager.

    Raises:
        ConfigError: the folder holds no run.
        StackError: nobody answers at the endpoint.
    """

    def __init__(self, run_dir: Path, endpoint: str, prefix: str = "") -> None:
        run = read_run(run_dir)
        config = replace(run.config, prefix=prefix or run.config.prefix)
        kind = run.setup.terrain.kind.replace("_", " ")
        title, setup = f"{kind}, seed {config.seed}", run.setup
        self.world = SceneWorld(
            title=title,
            config=config,
            robot=setup.robot,
            terrain=setup.terrain,
            camera=setup.camera,
        )
        self._clock = RunClock.of(config)
        self._maker = SceneMaker(self.world)
        self._arrivals: deque[RecordedMessage] = deque()
        self._events: deque[Event] = deque(maxlen=EVENTS_KEPT)
        self._simulated_ns = 0
        self._bus = ZenohBus(endpoint, config.prefix)
        self._onlooker = Onlooker(self._bus, CAPACITY)
        self._operator = self._bus.publisher("event", OPERATOR)

    def __enter__(self) -> "LiveRun":
        return self

    def __exit__(self, *_: object) -> None:
        self._bus.close()

    def connected(self) -> bool:
        """True where the run still answers."""
        return self._bus.connected()

    def _now_ns(self) -> int:
        """Until which moment of the run's clock it has heard what was said [ns].

        In lockstep the newest step.
        """
        if self._clock.lockstep:
            return self._simulated_ns
        return self._clock.of_monotonic(self._onlooker.heard_until_ns())

    def now(self) -> Scene:
        """The scene of this moment; in lockstep of the newest step."""
        self._arrivals.extend(
            a for raw in self._onlooker.drain() if (a := self._arrival(raw)) is not None
        )
        now_ns = self._now_ns()
        while self._arrivals and self._arrivals[0].arrival_ns <= now_ns - LOOK_BACK_NS:
            self._arrivals.popleft()
        return self._maker.make(self._arrivals, now_ns, tuple(self._events))

    def ask(self, code: str, detail: str = "") -> None:
        """Says as the operator what shall be done, see `saltus.runtime.stack`."""
        self._operator.put(
            Event(time_ns=self._now_ns(), process=OPERATOR, code=code, detail=detail)
        )

    def _arrival(self, raw: RawSample) -> RecordedMessage | None:
        topic = topic_of(raw.key)
        if topic is None:
            return None
        try:
            if topic.message is Event:
                _, event = unpack_sample(topic, raw)
                if isinstance(event, Event):
                    self._events.append(event)
            envelope = Envelope.from_bytes(raw.attachment)
        except MessageError:
            return None  # malformed: a recorder counts it
        if self._clock.lockstep:
            if raw.key in (
                "plant/truth",
                "controller/state",
            ):  # simulated time moves with what the robot says
                self._simulated_ns = max(self._simulated_ns, envelope.capture_ns)
            arrival_ns = self._simulated_ns
        else:
            arrival_ns = self._clock.of_monotonic(raw.arrival_ns)
        return RecordedMessage(arrival_ns, raw.key, envelope, raw.payload)
