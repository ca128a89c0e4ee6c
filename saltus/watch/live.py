"""A run that goes on, seen from its bus. It listens only while somebody watches, and keeps the last seconds."""

from collections import deque
from dataclasses import replace
from pathlib import Path

from saltus.clock import RunClock
from saltus.errors import MessageError
from saltus.recordings.recording import Arrival
from saltus.runtime.run_folder import read_run
from saltus.watch.onlooker import Onlooker
from saltus.watch.scene import LOOK_BACK_NS, Scene, SceneMaker, World
from saltus.wire.bus import RawSample, topic_of, unpack
from saltus.wire.codec import Envelope
from saltus.wire.messages import OPERATOR, Event
from saltus.wire.zenoh_bus import ZenohBus

CAPACITY = 4000
"""Samples that may wait to be looked at, some seconds of a run; what comes beyond is dropped here and slows nobody."""
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
        self.world = World(title=title, config=config, robot=setup.robot, terrain=setup.terrain, camera=setup.camera)
        self._clock = RunClock.of(config)
        self._maker = SceneMaker(self.world)
        self._arrivals: deque[Arrival] = deque()
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
        """Until which moment of the run's clock it has heard what was said [ns]; in lockstep the newest step."""
        if self._clock.lockstep:
            return self._simulated_ns
        return self._clock.of_monotonic(self._onlooker.heard_until_ns())

    def now(self) -> Scene:
        """The scene of this moment; in lockstep of the newest step."""
        self._arrivals.extend(a for raw in self._onlooker.drain() if (a := self._arrival(raw)) is not None)
        now_ns = self._now_ns()
        while self._arrivals and self._arrivals[0].arrival_ns <= now_ns - LOOK_BACK_NS:
            self._arrivals.popleft()
        return self._maker.make(self._arrivals, now_ns, tuple(self._events))

    def ask(self, code: str, detail: str = "") -> None:
        """Says as the operator what shall be done, see `saltus.runtime.stack`."""
        self._operator.put(Event(time_ns=self._now_ns(), process=OPERATOR, code=code, detail=detail))

    def _arrival(self, raw: RawSample) -> Arrival | None:
        topic = topic_of(raw.key)
        if topic is None:
            return None
        try:
            if topic.message is Event:
                _, event = unpack(topic, raw)
                if isinstance(event, Event):
                    self._events.append(event)
            envelope = Envelope.from_bytes(raw.attachment)
        except MessageError:
            return None  # malformed: a recorder counts it
        if self._clock.lockstep:
            if raw.key in ("plant/truth", "controller/state"):  # simulated time moves with what the robot says
                self._simulated_ns = max(self._simulated_ns, envelope.capture_ns)
            arrival_ns = self._simulated_ns
        else:
            arrival_ns = self._clock.of_monotonic(raw.arrival_ns)
        return Arrival(arrival_ns, raw.key, envelope, raw.payload)
