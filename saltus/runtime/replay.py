"""A process on a recorded run again: it is fed what it heard, and what it says is handed on.

The process runs as in lockstep, whatever the run's pace was: it takes one recorded message after
the other, in the order of the file, and answers without a clock. Of a lockstep run that is all that
it ever knew, so that its answers are those of the run to the bit. Of a real-time run it is what the
process would have answered had it never been late.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property
from importlib import import_module
from typing import NamedTuple

from saltus.config import PLAN_TOPICS, RunConfig
from saltus.errors import RecordingError
from saltus.recordings.recording import RecordedMessage, Recording
from saltus.runtime.process import ProcessContext
from saltus.runtime.programs import OPERATOR, PROGRAMS
from saltus.setup import Setup
from saltus.wire import codec
from saltus.wire.bus import Bell, Bus, Latest, MessageStream, RawSample, Slot
from saltus.wire.messages import Message


class ReplayedMessage(NamedTuple):
    """A message that a process says when it is fed a recording."""

    key: str
    """Below the robot's prefix, e.g. "policy/plan"."""
    message: Message
    payload: bytes


def body_of(name: str) -> Callable[..., None]:
    """The body of a process of the table; it takes a `ProcessContext`."""
    (program,) = (program for program in (*PROGRAMS, OPERATOR) if program.name == name)
    body: Callable[..., None] = import_module(f"{program.module}.__main__").body
    return body


def replay_process(
    name: str,
    recording: Recording,
    said: Callable[[ReplayedMessage], None],
    *,
    heard: Callable[[RecordedMessage], None] = lambda _: None,
    body: Callable[[ProcessContext], None] | None = None,
    config: RunConfig | None = None,
) -> None:
    """Runs a process to the end of a recording, or to its own.

    Args:
        name: Of the process, as in the table of programs.
        recording: The run.
        said: Called with each message that the process says, but for proofs of life.
        heard: Called with each message before the process is given it.
        body: Of the process; by default that of the table.
        config: Of the run, where it is to be another one than it was, as for another model.

    Raises:
        RecordingError: the recording has nothing of a topic that the process hears, or is of
            another version.
        SaltusError: those of the process.
    """
    known = replace(config or recording.known_config, pace="lockstep")
    if name == "controller" and known.link != "here":
        raise RecordingError(
            f"{recording.path}: its robot was another program, over DDS: of this run camera, "
            "heightmap and planner can be replayed"
        )
    feed = _Feed(recording, heard)
    context = _Context(name, known, recording, _RecordedBus(known.prefix, feed, said))
    feed.end = context.end
    (body or body_of(name))(context)


class _Feed(Bell):
    """Bell that brings the next recorded message, of those asked for, to whoever waits for one."""

    def __init__(self, recording: Recording, heard: Callable[[RecordedMessage], None]) -> None:
        super().__init__()
        self._recording, self._heard = recording, heard
        self.slots: dict[str, list[Slot]] = {}
        self.end: Callable[[], None] = lambda: None
        """Called when nothing is left."""

    @cached_property
    def _arrivals(self) -> Iterator[RecordedMessage]:
        """Messages of all that the process has asked for until it first waits."""
        recording, known = self._recording, set(self._recording.senders)
        # A robot that never jumps has no plans of jumps, one that never walks no joint targets
        may_lack = set(PLAN_TOPICS) if known & set(PLAN_TOPICS) else set[str]()
        for key in set(self.slots) - may_lack:
            if key not in known and not key.startswith(("event/", "operator/")):
                lost = f" (lost: {recording.lost[0]})" if recording.lost else ""
                raise RecordingError(
                    f"{recording.path} has no {key}, which is heard{lost}{_cure(key)}"
                )
        return recording.arrivals_of(self.slots)

    def wait(self, heard: int, timeout_s: float) -> None:
        """See `Bell.wait`; it never waits."""
        del heard, timeout_s
        arrival = next(self._arrivals, None)
        if arrival is None:
            self.end()
            return
        self._heard(arrival)
        sample = RawSample(
            arrival.key, arrival.payload, arrival.envelope.to_bytes(), arrival.arrival_ns
        )
        for slot in self.slots[arrival.key]:
            slot.push(sample)


def _cure(key: str) -> str:
    """Cure for messages that a recording lacks, where one is known."""
    if key.startswith("done/"):
        return ": only lockstep runs have it, and older ones have not; make one, saltus demo"
    if key.startswith("camera/depth/"):
        return ": name each further camera as its images were sent"
    return ""


class _RecordedBus(Bus):
    """A bus on which the others say what a recording has of them."""

    def __init__(self, prefix: str, feed: _Feed, said: Callable[[ReplayedMessage], None]) -> None:
        super().__init__(prefix, feed)
        self._slots, self._said = feed.slots, said

    def publisher(self, topic: str, suffix: str = "") -> "_Publisher":
        """See `Bus.publisher`."""
        return _Publisher(self._key(topic, suffix).removeprefix(f"{self.prefix}/"), self._said)

    def latest(self, topic: str, suffix: str = "", *, rings: bool = True) -> Latest:
        """See `Bus.latest`."""
        del rings  # all that comes is waited for
        slot = Slot(self.bell)
        key = self._key(topic, suffix).removeprefix(f"{self.prefix}/")
        self._slots.setdefault(key, []).append(slot)
        return self._latest(topic, slot)

    def stream(self, capacity: int = 0) -> MessageStream:
        """An empty one: processes have none."""
        return MessageStream(capacity)

    def connected(self) -> bool:
        """Always."""
        return True

    def close(self) -> None:
        """Nothing to leave."""


class _Publisher:
    """Hands on what is said under one key."""

    def __init__(self, key: str, said: Callable[[ReplayedMessage], None]) -> None:
        self._key, self._said = key, said

    def heard(self) -> bool:
        """Always."""
        return True

    def put(self, message: Message) -> None:
        """Encodes it, as it would have been sent."""
        self._said(ReplayedMessage(self._key, message, codec.encode_message(message)))


class _Context(ProcessContext):
    """Surroundings of a process that nobody supervises: values of the run from its recording."""

    def __init__(self, name: str, run_config: RunConfig, recording: Recording, bus: Bus) -> None:
        super().__init__(name, run_config, recording.path.parent, bus)
        self._recording = recording

    @cached_property
    def setup(self) -> Setup:
        """Everything that the run was of."""
        return self._recording.setup

    def end(self) -> None:
        """Nothing more will come."""
        self.stopped = True

    def ready(self) -> None:
        """Nobody waits for it."""

    def beat(self, *, ticks: int, overruns: int = 0) -> None:
        """Nobody asks for it."""
