"""A lockstep run within one process: the bodies of all four in threads on one bus,
and a recording of it.
"""

import threading
from collections.abc import Callable
from pathlib import Path

from memory_bus import MemoryBus, MemoryHub
from samples import put_run

from saltus.config import RunConfig
from saltus.named_setup import named_setup
from saltus.recordings.answers import AnswerComparison
from saltus.recordings.recorder import RECORDING_FILE, Recorder
from saltus.recordings.recording import Recording, read_recording
from saltus.runtime.process import ProcessContext
from saltus.runtime.programs import OPERATOR as OPERATED
from saltus.runtime.programs import PROGRAMS
from saltus.runtime.replay import body_of, replay_process
from saltus.wire import codec
from saltus.wire.bus import Publisher
from saltus.wire.messages import OPERATOR, DriveCommand, Event, RobotState

PATIENCE_S = 180.0


Driver = Callable[[RobotState], DriveCommand | None]


class OperatedHub(MemoryHub):
    """At the end of the first step an operator asks for something, by code and detail.

    `driver` says what is commanded at each state; it is there before the state.
    """

    def __init__(self, asked: tuple[str, str] | None, driver: Driver | None = None) -> None:
        super().__init__()
        self._asked, self._driver = asked, driver
        self._commands: Publisher | None = None

    def inject(self, key: str, payload: bytes, attachment: bytes) -> None:
        """See `MemoryHub.inject`."""
        if self._driver is not None and key.endswith("/controller/state"):
            command = self._driver(codec.decode_message(RobotState, payload))
            if self._commands is None:
                bus = MemoryBus(key.removesuffix("/controller/state"), self)
                self._commands = bus.publisher("operator/command")
            if command is not None:
                self._commands.put(command)
        super().inject(key, payload, attachment)
        if self._asked is not None and key.endswith("/controller/joints"):
            (code, detail), self._asked = self._asked, None
            bus = MemoryBus(key.removesuffix("/controller/joints"), self)
            event = Event(time_ns=0, process=OPERATOR, code=code, detail=detail)
            bus.publisher("event", OPERATOR).put(event)


def recorded_run(
    folder: Path,
    config: RunConfig,
    asked: tuple[str, str] | None = None,
    driver: Driver | None = None,
) -> Recording:
    """Makes a run to its end, in a folder of its own."""
    hub, contexts, threads = OperatedHub(asked, driver), [], []
    put_run(folder, config)
    others = MemoryBus(config.prefix, hub)
    stream = others.stream()
    programs = PROGRAMS if config.commands is None else (OPERATED, *PROGRAMS)
    for name in (program.name for program in programs):  # the controller comes last
        contexts.append(ProcessContext(name, config, folder, MemoryBus(config.prefix, hub)))
        ready = others.latest("status", name)
        threads.append(threading.Thread(target=body_of(name), args=contexts[-1:], daemon=True))
        threads[-1].start()
        assert ready.wait(PATIENCE_S) is not None
    threads[-1].join(PATIENCE_S)
    for context, thread in zip(contexts, threads, strict=True):
        context.stopped = True
        thread.join(PATIENCE_S)
        assert not thread.is_alive()
    with Recorder(folder / RECORDING_FILE, config, named_setup(config)) as recorder:
        recorder.write_all(stream)
    return read_recording(folder / RECORDING_FILE)


def compared(recording: Recording, name: str, config: RunConfig | None = None) -> AnswerComparison:
    """Answers of a process that is fed a recording again, beside those of the recording."""
    comparison = AnswerComparison(recording, name)
    replay_process(name, recording, lambda answer: comparison.take(*answer), config=config)
    comparison.finish()
    return comparison


def check_repeats(recording: Recording, name: str, least: int) -> None:
    """Asserts that a process says again what it said, to the bit, in more than `least` messages."""
    comparison = compared(recording, name)
    assert comparison.first is None, str(comparison.first)
    assert all(counts.equal for counts in comparison.topics.values())
    assert comparison.compared > least
