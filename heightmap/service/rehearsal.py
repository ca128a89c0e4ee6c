"""Rehearsals: the service answers for nobody shortly before somebody asks.

Ten milliseconds after an answer the processor sleeps and its caches hold other things: the next answer takes two to
three times as long as one that follows at once. A rehearsal, which nobody waits for, takes that upon itself.
"""

import time

from saltus.heightmap.service.fleet import Arrival, FleetService
from saltus.heightmap.service.link import RobotLink
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.runtime.process import ProcessContext
from saltus.wire.memory_bus import MemoryBus, MemoryHub

EARLY_NS = 400_000
"""How much earlier than expected a state may come: jitter of a sender at 100 Hz on a machine that is not overloaded."""
SMOOTHING = 0.1  # of the time that a rehearsal takes: a second to follow a processor that changes its speed
FIRST_NS = 500_000  # that time before it is known, as measured on a processor that was awake


class Rehearsal:
    """All that is done for an answer, from the bytes of the question to the bytes of the answer, on a bus of its own.

    Nothing is remembered from one time to the next but how long it takes.

    Args:
        context: Of a robot's run; only its bus is not used.
    """

    def __init__(self, context: ProcessContext) -> None:
        hub, self._name = MemoryHub(), context.bus.prefix
        bus = MemoryBus(self._name, hub)
        self._states, self._frames = bus.publisher("controller/state"), bus.publisher("camera/depth")
        self._link = RobotLink(ProcessContext(context.name, context.config, context.run_dir, bus))
        self._takes_ns: float = FIRST_NS

    @property
    def lead_ns(self) -> int:
        """How long before a state is due it must begin."""
        return round(self._takes_ns) + EARLY_NS

    def play(self, network: HeightmapNetwork, asked: Arrival) -> None:
        """Answers once more what was asked before."""
        begin_ns = time.monotonic_ns()
        if asked.frame is not None:
            self._frames.put(asked.frame)
        self._states.put(asked.state)
        again = self._link.take()
        if again is not None:
            self._link.answer(FleetService(network, [self._name]).step({self._name: again})[self._name])
        self._takes_ns += SMOOTHING * (time.monotonic_ns() - begin_ns - self._takes_ns)
