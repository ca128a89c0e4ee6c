"""The supervisor: it starts, watches, records and stops the processes of a run.

The supervisor hosts the Zenoh router in a folder of its owner. `Stack.poll` is its whole work:
whoever holds a stack calls `poll` at 10 Hz or more, or `wait`.

It obeys an operator, whose events are under `event/operator`: "stop" lets the robot land and ends
the run, "kill" ends the process that its detail names, as a test of what the others do about it.
The camera obeys "blind" itself, and the controller of a simulated robot "push".
"""

import contextlib
import json
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from saltus.clock import RunClock
from saltus.config import RunConfig
from saltus.errors import MessageError, RecordingError, StackError, check_known
from saltus.interrupts import WHOLE
from saltus.named_setup import named_setup
from saltus.recordings.recorder import RECORDING_FILE, Recorder
from saltus.runtime.child import Child, name_exit
from saltus.runtime.process import PEER_FLAG
from saltus.runtime.programs import OPERATOR as OPERATOR_PROGRAM
from saltus.runtime.programs import PROGRAMS, Program
from saltus.runtime.real_time import RealTimeFactor, RealTimeMonitor
from saltus.runtime.run_folder import CLIENT_FILE, write_run
from saltus.runtime.run_recorder import RunRecorder
from saltus.tuning import kept_small, prefer_this_thread
from saltus.wire.bus import Latest, MessageStream, Publisher, RawSample, sender_of, unpack_sample
from saltus.wire.codec import Envelope
from saltus.wire.joining import write_client
from saltus.wire.messages import OPERATOR, SUPERVISOR, Event, Message, ProcessStatus
from saltus.wire.router import NetworkAccess, open_router
from saltus.wire.sharing import Sharer
from saltus.wire.topics import TOPICS
from saltus.wire.zenoh_bus import ZenohBus

READY_TIMEOUT_S = 30.0
HUNG_S = 1.6
"""Three periods of its status: a message may be lost on a busy machine, and to end what lives ends
a run."""
SPARE_AFTER_S = 3.0
"""A robot whose camera died is down and stands (1.2 s): until then it needs the processors."""
RESTART_AFTER_S = 0.15
"""Half as long again as it takes the others to notice a loss: a process that loads would take their
processors."""
STOP_TIMEOUT_S = 3.0
STANDSTILL_S = 30.0  # of the machine; a landing in lockstep takes a few
LAST_WORDS_S = 0.5  # for the supervisor's own events to come back to its recorder
POLL_S = 0.01
DRAIN_S = 0.04
"""Period at which arrived messages are read, in real time. Every 10 ms it took the supervisor a
tenth more processor time (`saltus bench stack`): others displace its code from the caches
meanwhile."""


class Stack:
    """The processes of one run, as a context manager; tests bring their own table of programs.

    `run_dir` gets the files of `saltus.runtime.run_folder`, `recording.mcap` and
    `logs/<process>.log`; in run.toml the start of the run on the monotonic clock is filled in. With
    `network` others join over it. All limits below are in the clock of this run. Threads that this
    process starts later share one heap (`saltus.tuning`).

    Raises:
        ConfigError, ModelError: there is no such robot, grid, terrain, camera or profile.
        StackError: on entry where a process does not become ready; from `poll` and `wait` where the
            run cannot go on.
        RecordingError: from these and on exit, where the recording cannot be written any more.
    """

    def __init__(
        self,
        run_config: RunConfig,
        run_dir: Path,
        programs: tuple[Program, ...] = PROGRAMS,
        *,
        network: NetworkAccess | None = None,
    ) -> None:
        if run_config.commands is not None:
            programs = (OPERATOR_PROGRAM, *programs)
        self.config = replace(run_config, epoch_ns=run_config.epoch_ns or time.monotonic_ns())
        self.setup = named_setup(run_config)
        self.run_dir = run_dir
        self._network = network
        self.endpoint = ""
        """Where the router listens."""
        self.finished = False
        """True where the run came to its own end: the controller has returned."""
        self.rejected: dict[str, dict[str, int]] = {}
        """Messages that each process refused, by "topic/reason", from its last proof of life."""
        self.overruns: dict[str, int] = {}
        """Ticks that each process left out, from its last proof of life."""
        self._clock = RunClock.of(self.config)
        self._children = {
            p.name: Child(p, run_dir / "logs" / f"{p.name}.log", self._clock) for p in programs
        }
        self.real_time: RealTimeFactor | None = None
        """In real time: how the run has kept up lately; None until the robot has moved for some
        seconds."""
        self.too_slow: RealTimeFactor | None = None
        """In real time: how the run kept up when it first did not; None while it does."""
        self._monitor = RealTimeMonitor(self._clock, robot=programs[-1].name)
        self._heard_until_s = 0.0
        """All that had arrived by this time of the run's clock has been read."""
        self._begin_at_s: dict[str, float] = {}  # of those that have died
        self._events_sent = self._events_seen = 0
        self._resources = contextlib.ExitStack()
        self._bus: ZenohBus
        self._stream: MessageStream
        self._sharer: Sharer
        self._events: Publisher
        self._recorder: RunRecorder

    @property
    def recording(self) -> Path:
        """The recording of the run."""
        return self.run_dir / RECORDING_FILE

    @property
    def restarts(self) -> dict[str, int]:
        """How often each process was started again."""
        return {name: child.restarts for name, child in self._children.items()}

    def pid(self, name: str) -> int:
        """Process id of a process; `StackError` where it does not run now."""
        check_known("no process", name, self._children, error=StackError)
        pid = self._children[name].pid
        if pid is None:
            raise StackError(f"{name} is not running")
        return pid

    def latest(self, topic: str, suffix: str = "") -> Latest:
        """The newest message of a topic, to show progress."""
        return self._bus.latest(topic, suffix)

    def __enter__(self) -> "Stack":
        logs = self.run_dir / "logs"
        logs.mkdir(parents=True, exist_ok=True)
        for old in logs.glob("*.log"):
            old.unlink()
        write_run(self.run_dir, self.config, self.setup)
        try:
            self._open()
            self._start_all()
        except BaseException as error:
            self._resources.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def __exit__(self, *raised: Any) -> None:
        self._resources.__exit__(*raised)

    def poll(self) -> bool:
        """Records what has arrived and looks after the processes. Returns whether the run goes on.

        Raises:
            StackError: the controller died; in lockstep any process; or one cannot be started
                again, or not in time.
            RecordingError: the recording cannot be written any more.
        """
        if self._clock.lockstep or self._clock.elapsed_s() >= self._heard_until_s + DRAIN_S:
            self._drain()
        if self._recorder.error is not None:
            raise RecordingError(self._recorder.error)
        for child in self._children.values():
            self._look_after(child)
        return not self.finished

    def wait(self, timeout_s: float | None = None) -> bool:
        """Polls until the run has come to its end.

        Returns False where the timeout [s, run's clock] came first.
        """
        deadline_s = None if timeout_s is None else self._clock.elapsed_s() + timeout_s
        while self.poll():
            if deadline_s is not None and self._clock.elapsed_s() >= deadline_s:
                return False
            time.sleep(self._clock.machine_s(POLL_S))
        return True

    def _open(self) -> None:
        realtime = not self._clock.lockstep
        if realtime:
            self._resources.enter_context(prefer_this_thread())
        self._resources.enter_context(kept_small())
        self.endpoint, router = open_router(self._network, self.config.link_speed)
        self._resources.callback(router.close)
        write_client(self.run_dir / CLIENT_FILE, self.endpoint, speed=self.config.link_speed)
        self._bus = ZenohBus.of_run(self.endpoint, self.config, peer=realtime, dates=realtime)
        self._resources.callback(self._bus.close)
        self._stream = self._bus.stream()
        self._sharer = self._bus.sharer()
        self._events = self._bus.publisher("event", SUPERVISOR)
        with WHOLE:  # who is interrupted has a recording that ends, or none
            recorder = Recorder(self.recording, self.config, self.setup)
            failed = partial(self._event, "recording_failed")
            self._recorder = RunRecorder(recorder, self._clock, failed)
            self._resources.push(self._close_recorder)
        self._resources.callback(self._stop, restart=True)
        # First of all: the robot comes to a stand
        self._resources.callback(self._stop, restart=False)

    def _start_all(self) -> None:
        """All load at once; the run begins with the last of them, when nothing loads any more."""
        first = [child for child in self._children.values() if child.program.restart]
        last = [child for child in self._children.values() if not child.program.restart]
        for child in first:
            child.begin(self._arguments)
            self._load_spare(child)
        for child in last:
            child.load(self._arguments)
        self._poll_until(
            lambda: (
                all(child.ready for child in first)
                and not any(child.loading for child in first + last)
            )
        )
        for child in last:
            child.begin(self._arguments)
        self._poll_until(lambda: all(child.ready for child in last))

    def _load_spare(self, child: Child) -> None:
        if child.program.spare and self.config.pace == "realtime":
            try:
                child.load(self._arguments)
            except StackError as error:  # the run goes on with what it has
                self._event("no_spare", str(error))

    def _poll_until(self, condition: Callable[[], bool]) -> None:
        while not condition() and self.poll():
            time.sleep(POLL_S)

    @property
    def _arguments(self) -> list[str]:
        # In lockstep the router passes messages on in the order of cause and effect, as the
        # recorder dates them
        links = [] if self._clock.lockstep else [PEER_FLAG]
        return ["--run-dir", str(self.run_dir), "--endpoint", self.endpoint, *links]

    def _look_after(self, child: Child) -> None:
        if self.finished:
            return
        now_s = self._clock.elapsed_s()
        code = child.exit_code()
        begin_at_s = self._begin_at_s.get(child.name)
        if begin_at_s is not None:
            self._begin_again(child, begin_at_s)
        elif code is not None:
            self._ended(child, code)
        elif child.running() and not child.ready and now_s - child.started_s > READY_TIMEOUT_S:
            raise StackError(
                f"{child.name} is not ready after {READY_TIMEOUT_S:g} s{child.log_tail()}"
            )
        elif (
            child.alive_s is not None
            # Not until now: what comes while the rest is recorded has not been read
            and self._heard_until_s - child.alive_s > HUNG_S
            and self.config.pace == "realtime"
        ):
            child.kill()
            self._died(child, f"hung: no sign of life for {HUNG_S:g} s")
        elif (
            child.ready
            and not child.has_spare
            and now_s - max(child.started_s, child.tried_s) > SPARE_AFTER_S
        ):
            self._load_spare(child)

    def _ended(self, child: Child, code: int) -> None:
        self._drain()  # its last words
        if code == 0 and child.ready and not child.program.restart:
            self.finished = True
        else:
            self._died(child, name_exit(code))

    def _died(self, child: Child, how: str) -> None:
        self._event("process_died", f"{child.name}: {how}")
        replaceable = child.program.restart and self.config.pace == "realtime"
        if not (replaceable and child.ready):  # what dies before it is ready would do so for ever
            raise StackError(f"{child.name} died ({how}){child.log_tail()}")
        child.restarts += 1
        self._begin_again(
            child, self._clock.elapsed_s() + (0.0 if child.has_spare else RESTART_AFTER_S)
        )

    def _begin_again(self, child: Child, at_s: float) -> None:
        if self._clock.elapsed_s() < at_s:
            self._begin_at_s[child.name] = at_s
        else:
            self._begin_at_s.pop(child.name, None)
            child.begin(self._arguments)

    def _drain(self) -> None:
        self._heard_until_s = self._clock.elapsed_s()
        with WHOLE:  # who is interrupted loses no message between stream and recording
            samples = self._stream.drain()
            self._sharer.take(samples)
            for raw in samples:
                self._events_seen += raw.key == f"event/{SUPERVISOR}"
                self._note_life(raw)
                self._obey(raw)
            self._judge_real_time()
            self._recorder.take(samples)

    def _judge_real_time(self) -> None:
        """Says once that the run does not keep up.

        What a death holds up says nothing about the computer.
        """
        if any(self.restarts.values()):
            return
        factor = self.real_time = self._monitor.verdict()
        if factor is not None and not factor.kept and self.too_slow is None:
            self.too_slow = factor
            self._event("too_slow", str(factor))

    def _note_life(self, raw: RawSample) -> None:
        """Whatever a process says shows that it lives:
        who stood still for 0.5 s sends its status without links.
        """
        child = self._children.get(sender_of(raw.key))
        arrival_s = 1e-9 * self._clock.of_monotonic(raw.arrival_ns)
        if child is None or arrival_s < child.started_s:
            return
        if child.ready:
            child.alive_s = arrival_s
        if raw.key.startswith("status/"):
            self._note_status(child, raw, arrival_s)

    def _note_status(self, child: Child, raw: RawSample, arrival_s: float) -> None:
        envelope, status = _said("status", raw)
        if envelope is None or not isinstance(status, ProcessStatus):
            return
        if not child.ready:
            self._event("process_ready", f"{child.name}: after {arrival_s - child.started_s:.2f} s")
        child.alive_s = arrival_s
        if not self._clock.lockstep:
            self._monitor.take(status, envelope.sequence)
        self.rejected[child.name] = status.rejected
        self.overruns[child.name] = status.overruns

    def _obey(self, raw: RawSample) -> None:
        event = _said("event", raw)[1] if raw.key == f"event/{OPERATOR}" else None
        if isinstance(event, Event) and event.code == "stop":
            for child in self._children.values():
                if not child.program.restart:
                    child.signal(signal.SIGTERM)
        elif isinstance(event, Event) and event.code == "kill" and event.detail in self._children:
            self._children[event.detail].signal(signal.SIGKILL)

    def _event(self, code: str, detail: str) -> None:
        self._events_sent += 1
        self._events.put(
            Event(time_ns=self._clock.now_ns(), process=SUPERVISOR, code=code, detail=detail)
        )

    def _close_recorder(self, _: object, error: BaseException | None, __: object) -> None:
        in_time = self._clock.within(LAST_WORDS_S, STANDSTILL_S)
        while self._events_seen < self._events_sent and in_time():
            self._drain()
            time.sleep(POLL_S)
        self._drain()
        summary = {"restarts": json.dumps(self.restarts)}
        if error is not None:
            summary["error"] = str(error) or type(error).__name__
        self._recorder.close(summary, self.rejected, self._stream.overflowed)
        if self._recorder.error is not None and error is None:
            raise RecordingError(self._recorder.error)

    def _stop(self, *, restart: bool) -> None:
        group = [child for child in self._children.values() if child.program.restart == restart]
        for child in group:
            child.dismiss()
            child.signal(signal.SIGTERM)
        in_time = self._clock.within(STOP_TIMEOUT_S, STANDSTILL_S)
        while any(child.running() for child in group) and in_time():
            self._drain()
            time.sleep(POLL_S)
        for child in group:
            child.kill()


def _said(topic: str, raw: RawSample) -> tuple[Envelope, Message] | tuple[None, None]:
    """A sample as it was sent; None where it is malformed, which the recorder counts."""
    try:
        return unpack_sample(TOPICS[topic], raw)
    except MessageError:
        return None, None
