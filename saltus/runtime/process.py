"""Parts that the entry point of a process needs:
arguments, configuration, bus, clock, proof of life, a clean end.

A process is a pure class with `step(...)`; its `__main__` wires it to the bus and nothing else.
`saltus.policy.__main__` is an example: slow things first, then subscribe, then `context.ready()`,
as only now the run begins; then a loop until `context.stopped` that calls `context.beat(...)` at
least every 0.5 s and `run_process` around all of it. Where its row of the table says `hot`, a
process of a real-time run works along from `ready` on, unheard, until `beat` is told that it shall
begin.

A loop of fixed rate uses `Ticker(rate_hz, clock=context.clock)`. A wait that belongs to the run
lasts `context.clock.machine_s(seconds)`. The process ends by returning from the body (exit code 0),
by SIGTERM or SIGINT (`context.stopped` becomes true; finish and return), or when the supervisor or
its router are gone. A `SaltusError` out of the body becomes an event, one line on stderr and exit
code 2. When the controller returns, the run is over.
"""

import argparse
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path

from saltus import config
from saltus.clock import RunClock
from saltus.config import RunConfig
from saltus.errors import SaltusError
from saltus.runtime import cue
from saltus.runtime.run_folder import SETUP_FILE, read_config
from saltus.setup import Setup
from saltus.tuning import kept_small, prefer_loop, prefer_process
from saltus.wire.bus import Bus
from saltus.wire.messages import Event, ProcessStatus
from saltus.wire.zenoh_bus import ZenohBus

STATUS_PERIOD_S = 0.5
"""Period in the machine's time: a run that is slowed tells as soon how it goes."""
ROUTER_LOST_S = 2.0
"""How long the router may be gone, by the run's clock, less the time in which the process itself
stood still: links are given up meanwhile, and come back."""
LINKED_S = 1.0
"""After its opening a peer has links to all others, also on a busy computer: what is sent sooner
may reach nobody. In 0.3 s one of 21 had none."""
LINKED_LATEST_S = 3.0
"""Longest wait of a sender that nobody hears yet, on a busy computer."""
EXIT_ERROR = 2
PEER_FLAG = "--peer"


class ProcessContext:
    """A process of a run and its surroundings: configuration, clock, bus, and how it tells that it
    lives.

    If the supervisor has started it (`cued`, how it waits: see `saltus.runtime.cue`), it begins
    when it is told to, and in real time the scheduler is asked to prefer it.
    """

    def __init__(
        self, name: str, run_config: RunConfig, run_dir: Path, bus: Bus, *, cued: str = ""
    ) -> None:
        self.name = name
        self.config = run_config
        self.run_dir = run_dir
        self.bus = bus
        self.clock = RunClock.of(run_config)
        self.stopped = False
        """True where the process should finish and return."""
        self._cued = cued
        self._ready = False
        self._status = bus.publisher("status", name)
        self._events = bus.publisher("event", name)
        self._parent = os.getppid()
        self._next_status_s = -math.inf
        self.opened_s = self._looked_s = self.clock.elapsed_s()
        """When its bus had been opened, by the run's clock."""
        self._router_lost_s = 0.0

    @cached_property
    def setup(self) -> Setup:
        """Returns what the run is of."""
        return config.load_config(Setup, self.run_dir / SETUP_FILE)

    def ready(self) -> None:
        """Says that everything is loaded and subscribed; nothing is reported before.

        Returns when it shall begin.

        In real time it returns at once where the process is to work along: nobody hears it until
        `beat` is told that it shall begin. Its state follows from what it hears, so that it takes
        over without a gap.
        """
        if self._cued == cue.WORKING and self.config.pace == "realtime":
            cue.say_loaded()
            self.bus.muted = True
        elif self._cued and not cue.await_cue(lambda: self.stopped):
            self.stopped = True
        else:
            self._begin()

    def _begin(self) -> None:
        self.bus.muted = False
        if self._cued and self.config.pace == "realtime":
            prefer_loop(self.name)
        self._ready = True
        self._next_status_s = -math.inf
        self.beat(ticks=0)
        if not self._cued:  # somebody started it by hand, and waits for it
            sys.stdout.write(f"{self.name}: ready for {self.config.prefix}; Ctrl-C ends it\n")
            sys.stdout.flush()

    def _look_for_cue(self) -> None:
        begin = cue.may_begin()
        if begin:
            self._begin()
        elif begin is not None:
            self.stopped = True

    def beat(self, *, ticks: int, overruns: int = 0) -> None:
        """Proof of life, to be called in every round of the loop, at least every 0.5 s.

        Sends a status when due.

        `ticks` are rounds that did work, `overruns` rounds that were left out for lack of time,
        both so far.
        """
        if self.bus.muted:
            self._look_for_cue()
        now_s = self.clock.elapsed_s()
        if not self._ready or now_s < self._next_status_s:
            return
        self._next_status_s = now_s + STATUS_PERIOD_S * self.clock.speed
        intakes = [
            latest.take_intake() for latest in self.bus.latests if latest.topic.rate_hz > 0.0
        ]
        status = ProcessStatus(
            time_ns=self.clock.now_ns(),
            process=self.name,
            ready=True,
            ticks=ticks,
            overruns=overruns,
            rejected=dict(self.bus.rejected),
            received={intake.topic.name: intake.received for intake in intakes},
            silence_us={
                i.topic.name: round(1e-3 * i.silence_ns * self.clock.speed) for i in intakes
            },
        )
        self._status.put(status)
        self._check_surroundings(now_s)

    def heard(self) -> bool:
        """True where anybody hears its events."""
        return self._events.heard()

    def event(self, code: str, detail: str = "") -> None:
        """Tells, once, that something began."""
        self._events.put(
            Event(time_ns=self.clock.now_ns(), process=self.name, code=code, detail=detail)
        )

    def _check_surroundings(self, now_s: float) -> None:
        """A process must not outlive its supervisor, however that ended."""
        awake_s = min(now_s - self._looked_s, 2.0 * STATUS_PERIOD_S * self.clock.speed)
        self._looked_s = now_s
        self._router_lost_s = 0.0 if self.bus.connected() else self._router_lost_s + awake_s
        if os.getppid() != self._parent:
            self.stopped = True
        elif self._router_lost_s > ROUTER_LOST_S and not self.stopped:
            self.stopped = True
            sys.stderr.write(
                f"{self.name}: ends, as the run's router has not answered for {ROUTER_LOST_S:g} s\n"
            )


def run_process(
    name: str, body: Callable[[ProcessContext], None], arguments: Sequence[str] | None = None
) -> int:
    """Runs the body of a process, which is called once, and returns the exit code.

    `name` is a row of the process table; `arguments` stand for those of the command line.
    """
    parser = argparse.ArgumentParser(prog=name, description=f"The {name} process of a run.")
    parser.add_argument(
        "--run-dir", type=Path, required=True, help="folder of the run, with run.toml"
    )
    parser.add_argument(
        "--endpoint", required=True, help="Zenoh router, e.g. tcp/127.0.0.1:7447, or a client.json5"
    )
    parser.add_argument(
        PEER_FLAG,
        action="store_true",
        help="link to others on the router's machine, which is this one",
    )
    parser.add_argument(
        cue.FLAG,
        choices=(cue.IDLE, cue.WORKING),
        default="",
        dest="cued",
        help="wait for the supervisor when all is loaded",
    )
    options = parser.parse_args(arguments)
    try:
        run_config = read_config(options.run_dir)
        if (
            options.cued and run_config.pace == "realtime"
        ):  # while it loads, too: one that has died must be back soon
            prefer_process(name)
        with kept_small(), ZenohBus.of_run(options.endpoint, run_config, peer=options.peer) as bus:
            context = ProcessContext(name, run_config, options.run_dir, bus, cued=options.cued)
            _stop_on_signals(context)
            return _run_body(context, body)
    except SaltusError as error:
        return _failed(name, error)


def _run_body(context: ProcessContext, body: Callable[[ProcessContext], None]) -> int:
    try:
        body(context)
    except SaltusError as error:
        time.sleep(
            context.clock.machine_s(
                max(0.0, context.opened_s + LINKED_S - context.clock.elapsed_s())
            )
        )
        latest_s = time.monotonic() + LINKED_LATEST_S
        while not context.heard() and time.monotonic() < latest_s:
            time.sleep(0.01)
        context.event("error", str(error))
        return _failed(context.name, error)
    return 0


def _failed(name: str, error: SaltusError) -> int:
    sys.stderr.write(f"{name}: {error}\n")
    return EXIT_ERROR


def _stop_on_signals(context: ProcessContext) -> None:
    def stop(*_: object) -> None:
        context.stopped = True

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
